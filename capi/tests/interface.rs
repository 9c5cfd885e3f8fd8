//! The header is the source's, the examples compile without a warning, run clean and give the bytes of the Rust library, and
//! wrong use is told.
#![expect(clippy::unwrap_used, reason = "a test may fail")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Where the library is installed for these tests: its headers, CMake and pkg-config files are those that hosts get.
fn installed() -> &'static Path {
    static INSTALLED: OnceLock<PathBuf> = OnceLock::new();
    let install = || {
        let prefix = Path::new(env!("CARGO_TARGET_TMPDIR")).join("capi");
        // The library was built with this program, and lies beside it.
        let program = std::env::current_exe().unwrap();
        let built = program.parent().unwrap();
        succeeds(Command::new(Path::new(ROOT).join("install.sh")).arg(&prefix).arg(built));
        prefix
    };
    INSTALLED.get_or_init(install)
}

fn succeeds(command: &mut Command) -> String {
    let Output { status, stdout, stderr } = command.output().unwrap();
    let (stdout, stderr) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
    assert!(status.success(), "{command:?}\n{stdout}\n{stderr}");
    stdout.into_owned()
}

/// A program that is linked to the installed library. Cargo's own search path, which may lead to an older one, is left out.
fn linked(path: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command = Command::new(path);
    command.env_remove("LD_LIBRARY_PATH");
    command
}

/// Whether a program is there; without it, and unless it is required, a test is skipped.
fn has(program: &str) -> bool {
    let there = Command::new(program).arg("--version").output().is_ok();
    let required = std::env::var("LUMENMESH_REQUIRE_TOOLS").is_ok_and(|value| value == "1");
    assert!(there || !required, "{program} is missing");
    if !there {
        eprintln!("SKIPPED: no {program}");
    }
    there
}

const WARNINGS: [&str; 5] = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-O1"];

/// Compiles a program against the installed library.
fn compiled(source: &Path, to: &Path, compiler: &str, standard: &str) {
    let (include, library) = (installed().join("include"), installed().join("lib"));
    let mut command = Command::new(compiler);
    command.args(WARNINGS).arg(standard).arg("-I").arg(include).arg(source).arg("-o").arg(to);
    command
        .arg("-L")
        .arg(&library)
        .args(["-llumenmesh", "-lm"])
        .arg(format!("-Wl,-rpath,{}", library.display()));
    succeeds(&mut command);
}

fn example(name: &str, folder: &Path) -> PathBuf {
    let source = Path::new(ROOT).join("examples").join(name);
    let to = folder.join(name.replace('.', "_"));
    match name.ends_with(".cpp") {
        true => compiled(&source, &to, "c++", "-std=c++17"),
        false => compiled(&source, &to, "cc", "-std=c99"),
    }
    to
}

/// A program with the text of its functions' statements: it ends with 1 at the first that fails.
fn program(statements: &str, folder: &Path) -> Output {
    let source = folder.join("program.c");
    let text = format!(
        "#include <lumenmesh.h>\n#include <math.h>\n#include <stdio.h>\n#include <stdlib.h>\n#include <string.h>\n\
         #define SAYS(call, status, part) do {{ LumenmeshStatus got = (call); \\\n\
         if (got != (status) || !strstr(lumenmesh_last_error(), part)) {{ \\\n\
         printf(\"line %d: %d: %s\\n\", __LINE__, (int)got, lumenmesh_last_error()); return 1; }} }} while (0)\n\
         #define OK(call) do {{ if ((call) != LUMENMESH_STATUS_OK) {{ \\\n\
         printf(\"line %d: %s\\n\", __LINE__, lumenmesh_last_error()); return 1; }} }} while (0)\n\
         int main(void) {{\n{statements}\nreturn 0;\n}}\n"
    );
    std::fs::write(&source, text).unwrap();
    let to = folder.join("program");
    compiled(&source, &to, "cc", "-std=c99");
    linked(to).current_dir(folder).output().unwrap()
}

fn passes(statements: &str) {
    let folder = tempfile::tempdir().unwrap();
    let output = program(statements, folder.path());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

#[test]
fn the_header_is_made_from_the_source() {
    let config = cbindgen::Config::from_file(Path::new(ROOT).join("cbindgen.toml")).unwrap();
    let mut made = Vec::new();
    let bindings = cbindgen::Builder::new().with_crate(ROOT).with_config(config).generate().unwrap();
    bindings.write(&mut made);
    let path = Path::new(ROOT).join("include/lumenmesh.h");
    if std::env::var_os("LUMENMESH_WRITE_HEADER").is_some() {
        std::fs::write(&path, &made).unwrap();
    }
    let made = String::from_utf8(made).unwrap();
    assert!(made.contains("lumenmesh_live_push"), "{made}");
    assert!(
        std::fs::read_to_string(&path).unwrap() == made,
        "include/lumenmesh.h is not that of the source: run this test with LUMENMESH_WRITE_HEADER=1"
    );
}

/// A recording, and the mesh that the Rust library makes of it.
fn simulated(folder: &Path) -> (PathBuf, Vec<u8>) {
    use lumenmesh_core::reconstruction::Reconstructor;
    use lumenmesh_core::settings::{Backend, Settings};
    use lumenmesh_core::simulate::{Insertion, Phantom, Shape, Simulation, SimulationSettings};
    let vessel = Phantom::from("stenosis".parse::<Shape>().unwrap()).vessel().unwrap();
    let settings = SimulationSettings::default().with_insertion(Insertion::steady());
    let simulation = Simulation::run(vessel, &settings).unwrap();
    let recording = folder.join("recording.mat");
    simulation.recording.write(&recording).unwrap();
    simulation.vessel.surface().write(&folder.join("truth.ply")).unwrap();
    let settings = Settings::default().with_backend(Backend::Cpu);
    let lumen = Reconstructor::new(settings).run(&simulation.recording).unwrap();
    let mesh = folder.join("expected.vtp");
    lumen.surface().write(&mesh).unwrap();
    (recording, std::fs::read(mesh).unwrap())
}

#[test]
fn a_recording_gives_the_bytes_of_the_rust_library() {
    if !has("cc") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (recording, expected) = simulated(folder.path());
    let batch = example("batch.c", folder.path());
    let mesh = folder.path().join("mesh.vtp");
    let said = succeeds(linked(&batch).arg(&recording).arg(&mesh).arg(folder.path().join("truth.ply")));
    assert!(std::fs::read(&mesh).unwrap() == expected);
    let error_mm: f64 =
        said.split("fitting error ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!(error_mm > 0.0 && error_mm < 0.3, "{said}");
    let failed = linked(&batch).args(["no.mat", "mesh.vtp"]).current_dir(folder.path()).output().unwrap();
    assert!(!failed.status.success());
    let said = String::from_utf8_lossy(&failed.stderr).into_owned();
    assert!(said.starts_with("batch: no.mat: cannot read: "), "{said}");
}

#[test]
fn live_in_c_and_in_cpp_give_the_same_and_run_clean() {
    if !(has("cc") && has("c++")) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let [c, cpp] = ["live.c", "live.cpp"].map(|name| example(name, folder.path()));
    let [of_c, of_cpp] = ["c.vtp", "cpp.vtp"].map(|name| folder.path().join(name));
    let said = succeeds(linked(&c).arg(&of_c));
    assert_eq!(succeeds(linked(&cpp).arg(&of_cpp)), said);
    let bytes = std::fs::read(&of_c).unwrap();
    assert!(bytes.len() > 10_000 && bytes == std::fs::read(&of_cpp).unwrap());
    if has("valgrind") {
        // Memory that a program may still reach at its end, such as thread pools, is no leak.
        let mut checked = linked("valgrind");
        checked.args([
            "--quiet",
            "--error-exitcode=9",
            "--leak-check=full",
            "--errors-for-leak-kinds=definite",
        ]);
        let output = checked.arg(&c).arg(folder.path().join("checked.vtp")).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn wrong_use_is_told() {
    if !has("cc") {
        return;
    }
    passes(
        r#"
LumenmeshSettings *settings = NULL;
LumenmeshRecording *recording = NULL;
LumenmeshMesh *mesh = NULL;
LumenmeshLive *live = NULL;
OK(lumenmesh_settings_new(&settings));
SAYS(lumenmesh_settings_new(NULL), LUMENMESH_STATUS_INVALID_ARGUMENT, "settings: found null");
SAYS(lumenmesh_settings_set(settings, "node", "3"), LUMENMESH_STATUS_INVALID_INPUT, "setting node: found no setting of that name");
SAYS(lumenmesh_settings_set(settings, NULL, "3"), LUMENMESH_STATUS_INVALID_ARGUMENT, "name: found null");
SAYS(lumenmesh_settings_set(settings, "adapter", "\xff"), LUMENMESH_STATUS_INVALID_ARGUMENT, "not UTF-8");
char small[4];
size_t length = 0;
SAYS(lumenmesh_settings_toml(settings, small, sizeof small, &length), LUMENMESH_STATUS_BUFFER_TOO_SMALL, "found a buffer for 4, expected one for ");
OK(lumenmesh_settings_toml(settings, NULL, 0, &length));
char *text = malloc(length);
OK(lumenmesh_settings_toml(settings, text, length, NULL));
if (strlen(text) + 1 != length || !strstr(text, "method = \"sweep\"")) return 2;
free(text);

/* Handles. */
OK(lumenmesh_settings_free(settings));
SAYS(lumenmesh_settings_free(settings), LUMENMESH_STATUS_INVALID_ARGUMENT, "freed or is of another kind");
SAYS(lumenmesh_settings_set(settings, "nodes", "3"), LUMENMESH_STATUS_INVALID_ARGUMENT, "freed or is of another kind");
OK(lumenmesh_settings_free(NULL));
SAYS(lumenmesh_recording_frames(NULL, &length), LUMENMESH_STATUS_INVALID_ARGUMENT, "recording: found null");
OK(lumenmesh_live_new(NULL, &live));
SAYS(lumenmesh_mesh_free((LumenmeshMesh *)live), LUMENMESH_STATUS_INVALID_ARGUMENT, "mesh: found a handle that was freed or is of another kind");

/* Recordings. */
double identity[32] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 5, 0, 0, 0, 1};
double contour[12] = {1, 0, 0, 1, -1, 0, 1, 0, 0, 1, -1, 0};
size_t points[2] = {3, 3};
SAYS(lumenmesh_recording_new(2, NULL, points, contour, NULL, &recording), LUMENMESH_STATUS_INVALID_ARGUMENT, "world_from_sensor: found null, expected 32 values");
SAYS(lumenmesh_recording_new((size_t)-1, identity, points, contour, NULL, &recording), LUMENMESH_STATUS_INVALID_ARGUMENT, "which no memory holds");
size_t huge[2] = {(size_t)-1, 2};
SAYS(lumenmesh_recording_new(2, identity, huge, contour, NULL, &recording), LUMENMESH_STATUS_INVALID_ARGUMENT, "which no memory holds");
identity[15] = 2;
SAYS(lumenmesh_recording_new(2, identity, points, contour, NULL, &recording), LUMENMESH_STATUS_INVALID_INPUT, "frame 0: pose: found a matrix whose last row is [0.0, 0.0, 0.0, 2.0]");
identity[15] = 1;
OK(lumenmesh_recording_new(2, identity, points, contour, NULL, &recording));
OK(lumenmesh_recording_frames(recording, &length));
if (length != 2) return 3;
LumenmeshLumen *lumen = NULL;
LumenmeshStatus status = lumenmesh_reconstruct(recording, NULL, &lumen);
if (status != LUMENMESH_STATUS_INVALID_INPUT || lumen) return 4;
OK(lumenmesh_recording_free(recording));
OK(lumenmesh_recording_new(0, NULL, NULL, NULL, NULL, &recording));
SAYS(lumenmesh_reconstruct(recording, NULL, &lumen), LUMENMESH_STATUS_INVALID_INPUT, "expected");
OK(lumenmesh_recording_free(recording));
SAYS(lumenmesh_recording_read("no.mat", &recording), LUMENMESH_STATUS_FILE, "no.mat: cannot read");

/* Meshes. */
double corners[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
uint32_t triangle[3] = {0, 1, 3};
SAYS(lumenmesh_mesh_new(3, corners, 1, triangle, &mesh), LUMENMESH_STATUS_INVALID_INPUT, "found node 3, expected a node below 3");
triangle[2] = 2;
OK(lumenmesh_mesh_new(3, corners, 1, triangle, &mesh));
double vertices[9];
SAYS(lumenmesh_mesh_copy_vertices(mesh, vertices, 8), LUMENMESH_STATUS_BUFFER_TOO_SMALL, "vertices: found a buffer for 8, expected one for 9");
SAYS(lumenmesh_mesh_copy_array(mesh, "support", vertices, 9), LUMENMESH_STATUS_INVALID_ARGUMENT, "array \"support\"");
SAYS(lumenmesh_mesh_write(mesh, "mesh.ply", "up"), LUMENMESH_STATUS_INVALID_INPUT, "setting space: found \"up\", expected ras or lps");
SAYS(lumenmesh_mesh_write(mesh, "no/mesh.ply", NULL), LUMENMESH_STATUS_FILE, "cannot write");
OK(lumenmesh_mesh_write(mesh, "mesh.ply", "lps"));
OK(lumenmesh_mesh_free(mesh));
OK(lumenmesh_mesh_read("mesh.ply", &mesh));
OK(lumenmesh_mesh_copy_vertices(mesh, vertices, 9));
if (vertices[3] != 1) return 5;

/* Live: a frame that is refused leaves the vessel as it was. */
LumenmeshChange change;
SAYS(lumenmesh_live_push(live, NULL, 3, contour, NAN, &change), LUMENMESH_STATUS_INVALID_ARGUMENT, "world_from_sensor: found null");
SAYS(lumenmesh_live_push(live, identity, 3, NULL, NAN, &change), LUMENMESH_STATUS_INVALID_ARGUMENT, "contour_mm: found null, expected 6 values");
OK(lumenmesh_live_push(live, identity, 3, contour, NAN, &change));
if (change.frame != 0) return 6;
OK(lumenmesh_live_reset(live));
OK(lumenmesh_live_push(live, identity, 3, contour, NAN, NULL));
identity[0] = -1;
OK(lumenmesh_live_push(live, identity, 3, contour, NAN, &change));
if (change.frame != 1 || change.left_out != 1) return 7;
OK(lumenmesh_live_left_out(live, NULL, 0, &length));
text = malloc(length);
OK(lumenmesh_live_left_out(live, text, length, NULL));
if (!strstr(text, "right-handed")) return 8;
free(text);
identity[0] = NAN;
OK(lumenmesh_live_push(live, identity, 0, NULL, NAN, &change));
OK(lumenmesh_live_engine(live, NULL, 0, &length));
text = malloc(length);
SAYS(lumenmesh_live_engine(live, text, length - 1, NULL), LUMENMESH_STATUS_BUFFER_TOO_SMALL, "engine: found a buffer for ");
OK(lumenmesh_live_engine(live, text, length, NULL));
if (!strstr(text, "\"name\":\"cpu\"")) return 10;
free(text);

/* Snapshots, and the batch result of frames that were kept. */
LumenmeshLive *again = NULL;
SAYS(lumenmesh_live_restore("no.state", &again), LUMENMESH_STATUS_FILE, "no.state: cannot read");
SAYS(lumenmesh_live_restore("mesh.ply", &again), LUMENMESH_STATUS_INVALID_INPUT, "mesh.ply: content: found another kind of file");
SAYS(lumenmesh_live_snapshot(live, NULL), LUMENMESH_STATUS_INVALID_ARGUMENT, "path: found null");
OK(lumenmesh_live_snapshot(live, "live.state"));
OK(lumenmesh_live_restore("live.state", &again));
identity[0] = 1;
OK(lumenmesh_live_push(again, identity, 3, contour, NAN, &change));
if (change.frame != 3 || !(change.total_s > 0)) return 9;
SAYS(lumenmesh_live_finish(again, &lumen), LUMENMESH_STATUS_INVALID_INPUT, "found 4 that were not kept");
SAYS(lumenmesh_live_keep_frames(again), LUMENMESH_STATUS_INVALID_INPUT, "found 4 that were not kept");
OK(lumenmesh_live_reset(again));
OK(lumenmesh_live_keep_frames(again));
SAYS(lumenmesh_live_finish(again, &lumen), LUMENMESH_STATUS_INVALID_INPUT, "expected");
OK(lumenmesh_live_free(again));
OK(lumenmesh_live_free(live));
SAYS(lumenmesh_live_push(live, identity, 3, contour, NAN, &change), LUMENMESH_STATUS_INVALID_ARGUMENT, "freed");
OK(lumenmesh_mesh_free(mesh));
"#,
    );
}

#[test]
fn a_cmake_project_and_pkg_config_find_the_library() {
    if !has("cmake") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let project = format!(
        "cmake_minimum_required(VERSION 3.16)\nproject(host C CXX)\nfind_package(lumenmesh 0.2 REQUIRED)\n\
         find_package(lumenmesh 9.0 QUIET)\nif(lumenmesh_FOUND)\nmessage(FATAL_ERROR \"any version will do\")\nendif()\n\
         add_executable(host {}/examples/live.cpp)\ntarget_link_libraries(host lumenmesh::lumenmesh)\n",
        ROOT
    );
    std::fs::write(folder.path().join("CMakeLists.txt"), project).unwrap();
    let build = folder.path().join("build");
    let prefix = format!("-DCMAKE_PREFIX_PATH={}", installed().display());
    succeeds(Command::new("cmake").arg("-S").arg(folder.path()).arg("-B").arg(&build).arg(prefix));
    succeeds(Command::new("cmake").arg("--build").arg(&build));
    let said = succeeds(linked(build.join("host")).arg(folder.path().join("mesh.ply")));
    assert!(said.contains(" drawn in 120 frames"), "{said}");
    if has("pkg-config") {
        let mut asked = Command::new("pkg-config");
        asked.env("PKG_CONFIG_PATH", installed().join("lib/pkgconfig")).args([
            "--libs",
            "--cflags",
            "lumenmesh",
        ]);
        let flags = succeeds(&mut asked);
        assert!(flags.contains("-llumenmesh") && flags.contains("-I"), "{flags}");
    }
}

#[test]
fn a_reconstruction_is_followed_and_ended() {
    if !has("c++") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (recording, _) = simulated(folder.path());
    let source = folder.path().join("progress.cpp");
    let text = r#"
#include <lumenmesh.hpp>
#include <atomic>
#include <cstdio>
#include <cstring>
#include <mutex>
#include <set>
int main(int, char **argv) {
    const lumenmesh::Recording recording(argv[1]);
    for (const char *method : {"sweep", "cylinders"}) {
        const auto settings = std::move(lumenmesh::Settings().set("method", method).set("backend", "cpu"));
        std::atomic<int> all{0}, some{0};
        std::mutex lock;
        std::set<std::size_t> steps;
        lumenmesh::Lumen whole(recording, settings, [&](const char *, std::size_t done, std::size_t total) {
            all++;
            const std::lock_guard<std::mutex> held(lock);
            steps.insert(done);
            return done <= total;
        });
        for (const bool throws : {false, true}) {
            some = 0;
            try {
                lumenmesh::Lumen(recording, settings, [&](const char *, std::size_t, std::size_t) -> bool {
                    some++;
                    if (throws) throw 1;
                    return false;
                });
                return 3;
            } catch (const lumenmesh::Error &error) {
                if (error.status() != LUMENMESH_STATUS_CANCELLED || std::strcmp(error.what(), "cancelled")) return 4;
            }
        }
        std::printf("%s %d, %s\n", method, int(steps.size()), all > int(steps.size()) ? "asked again" : "asked once");
        // Threads that were in the middle of a step finish it.
        if (some < 1 || some >= all) return 5;
        if (whole.mesh().triangles().empty()) return 6;
    }
    return 0;
}
"#;
    std::fs::write(&source, text).unwrap();
    let to = folder.path().join("progress");
    compiled(&source, &to, "c++", "-std=c++17");
    let said = succeeds(linked(&to).arg(&recording));
    // Six stages, and once more before every iteration of a fit.
    assert!(said.contains("sweep 6, asked again\n") && said.contains("cylinders "), "{said}");
}

#[test]
fn nothing_else_is_exported() {
    if !(cfg!(target_os = "linux") && has("nm")) {
        return;
    }
    let library = installed().join("lib/liblumenmesh.so");
    let symbols = succeeds(Command::new("nm").args(["-D", "--defined-only"]).arg(library));
    let names: Vec<&str> = symbols.lines().filter_map(|line| line.split(' ').next_back()).collect();
    assert!(names.len() > 25, "{symbols}");
    let others: Vec<&&str> = names.iter().filter(|name| !name.starts_with("lumenmesh_")).collect();
    assert!(others.is_empty(), "{others:?}");
}

/// The Debian package of what was built for these tests, tried by the script where it is unpacked, holds all that it should.
#[test]
fn the_debian_package_has_command_library_pages_and_completions() {
    let program = std::env::current_exe().unwrap();
    let built = program.parent().unwrap();
    let command = built.with_file_name("lumenmesh");
    let required = std::env::var("LUMENMESH_REQUIRE_TOOLS").is_ok_and(|value| value == "1");
    if !command.exists() {
        assert!(!required, "{} is missing: build with -p lumenmesh too", command.display());
        eprintln!("SKIPPED: no {}", command.display());
        return;
    }
    if !(has("dpkg-deb") && has("objdump") && has("cmake")) {
        return;
    }
    let out = tempfile::tempdir().unwrap();
    succeeds(
        linked(Path::new(ROOT).join("../scripts/package.sh"))
            .arg("deb")
            .env("BUILT", built)
            .env("COMMAND", &command)
            .env("OUT", out.path()),
    );
    let package = std::fs::read_dir(out.path()).unwrap().map(|entry| entry.unwrap().path());
    let package = package.into_iter().find(|path| path.extension().is_some_and(|e| e == "deb")).unwrap();
    let list = succeeds(Command::new("dpkg-deb").arg("--contents").arg(&package));
    let holds = |path: &str| list.lines().any(|line| line.ends_with(path));
    for path in [
        "./usr/bin/lumenmesh",
        "./usr/include/lumenmesh.h",
        "./usr/include/lumenmesh.hpp",
        "./usr/lib/liblumenmesh.so",
        "./usr/lib/cmake/lumenmesh/lumenmeshConfig.cmake",
        "./usr/lib/cmake/lumenmesh/lumenmeshConfigVersion.cmake",
        "./usr/lib/pkgconfig/lumenmesh.pc",
        "./usr/share/man/man1/lumenmesh.1.gz",
        "./usr/share/man/man1/lumenmesh-live.1.gz",
        "./usr/share/bash-completion/completions/lumenmesh",
        "./usr/share/zsh/vendor-completions/_lumenmesh",
        "./usr/share/fish/vendor_completions.d/lumenmesh.fish",
        "./usr/share/doc/lumenmesh/copyright",
    ] {
        assert!(holds(path), "no {path} in\n{list}");
    }
    assert!(!holds("liblumenmesh.a"), "{list}");
    // What it says of itself does not know the folder that it was built in.
    let folder = tempfile::tempdir().unwrap();
    succeeds(Command::new("dpkg-deb").arg("--extract").arg(&package).arg(folder.path()));
    let pkg_config = std::fs::read_to_string(folder.path().join("usr/lib/pkgconfig/lumenmesh.pc")).unwrap();
    assert!(pkg_config.starts_with("prefix=/usr\n"), "{pkg_config}");
}

/// The archive that `cargo package` would make of the crate has the files that it is built from, its licences, and nothing
/// of the other members or of what was built.
#[test]
fn the_crate_has_what_it_is_built_from() {
    let arguments = ["package", "--list", "--allow-dirty", "--offline", "-p", "lumenmesh"];
    let list = succeeds(Command::new(env!("CARGO")).args(arguments).current_dir(Path::new(ROOT).join("..")));
    let has = |path: &str| list.lines().any(|line| line == path);
    for path in ["Cargo.toml", "Cargo.lock", "src/lib.rs", "src/main.rs", "README.md", "THIRD_PARTY_NOTICES"]
    {
        assert!(has(path), "no {path} in\n{list}");
    }
    assert!(has("LICENSE-MIT") && has("LICENSE-APACHE"), "{list}");
    assert!(list.lines().filter(|line| line.starts_with("shaders/") && line.ends_with(".wgsl")).count() > 30);
    assert!(!list.lines().any(|line| ["capi/", "python/", "target/"].iter().any(|f| line.starts_with(f))));
}
