//! The order of the source's folders: a module imports only from those before it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Modules from the bottom to the top; the longest prefix of a path decides.
const ORDER: &[&str] = &[
    "setters",
    "text",
    "numerics",
    "geometry",
    "gpu",
    "error",
    "output",
    "matfile",
    "recording",
    "surface",
    "openigtlink",
    "settings",
    "engine",
    "cylinders::tube",
    "cylinders::estimate",
    "cylinders::passes",
    "cylinders::track",
    "cylinders::fit",
    "cylinders::merge",
    "cylinders::live",
    "cylinders",
    "sweep::prepare",
    "sweep::wall",
    "sweep::support",
    "sweep::tracker",
    "sweep::errors",
    "sweep::surface",
    "sweep::motion",
    "sweep::live",
    "sweep::report",
    "sweep",
    "branching",
    "reconstruction",
    "evaluate",
    "anatomy",
    "flow",
    "simulate",
    "study",
    "report",
    "stream::queue",
    "stream::arrivals",
    "stream::times",
    "stream::source",
    "stream::update",
    "stream::page",
    "stream::slicer",
    "stream::files",
    "stream::log",
    "stream::run",
    "stream",
    "cli",
    "low_level",
];

/// Folders that stand beside each other: neither imports from the other.
const APART: [[&str; 2]; 1] = [["cylinders", "sweep"]];

/// One import: a file, and the module path that it names.
type Import = (String, String);

fn rank(module: &str) -> Option<usize> {
    let is_within = |prefix: &str| module == prefix || module.starts_with(&format!("{prefix}::"));
    (0..ORDER.len()).filter(|&k| is_within(ORDER[k])).max_by_key(|&k| ORDER[k].len())
}

fn folder(module: &str) -> &str {
    module.split("::").next().unwrap_or(module)
}

/// Why an import is against the order, if it is.
fn fault((from, to): &Import) -> Option<String> {
    let (Some(here), Some(there)) = (rank(from), rank(to)) else {
        return Some(format!("{from} imports {to}: one of them is not in the order"));
    };
    let apart = APART.iter().any(|pair| {
        let pair = [pair[0], pair[1]];
        folder(from) != folder(to) && pair.contains(&folder(from)) && pair.contains(&folder(to))
    });
    (there > here || apart).then(|| format!("{from} imports {to}, which stands above it or beside it"))
}

/// The module path of a source file.
fn module_of(file: &Path, root: &Path) -> String {
    let relative = file.strip_prefix(root).unwrap().with_extension("");
    let mut parts: Vec<_> = relative.iter().map(|part| part.to_str().unwrap()).collect();
    if parts.last() == Some(&"mod") {
        parts.pop();
    }
    parts.join("::")
}

/// The module paths that a text names through `crate::` and `super::`, without those in comments and in its tests.
fn named_paths(text: &str, module: &str) -> BTreeSet<String> {
    let code: String = text
        .split("\n#[cfg(test)]\nmod tests")
        .next()
        .unwrap_or_default()
        .split("\n#[cfg(all(test")
        .next()
        .unwrap_or_default()
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"))
        .map(|line| line.split(" // ").next().unwrap_or_default().to_owned() + "\n")
        .collect();
    let mut found = BTreeSet::new();
    // `pub(in crate::sweep)` is no import.
    let is_visibility = |start: usize| code[..start].ends_with("in ");
    for (start, _) in code.match_indices("crate::").filter(|(start, _)| !is_visibility(*start)) {
        let lists = |rest: &str| rest.split_once('}').map_or(String::new(), |(list, _)| list.to_owned());
        let rest = &code[start + "crate::".len()..];
        let paths = match rest.strip_prefix('{') {
            Some(list) => lists(list).split(',').map(|item| path_at(item.trim())).collect(),
            None => vec![path_at(rest)],
        };
        found.extend(paths.into_iter().map(|path| match path.as_str() {
            "Error" | "Result" | "error" => "error".to_owned(),
            _ => path,
        }));
    }
    for (start, _) in code.match_indices("super::") {
        let is_first = !code[..start].ends_with("super::");
        if !is_first || is_visibility(start) {
            continue;
        }
        let mut parents: Vec<&str> = module.split("::").collect();
        let mut rest = &code[start..];
        while let Some(after) = rest.strip_prefix("super::") {
            parents.pop();
            rest = after;
        }
        let path = parents.iter().map(|p| (*p).to_owned()).chain([path_at(rest)]).filter(|p| !p.is_empty());
        found.insert(path.collect::<Vec<_>>().join("::"));
    }
    found.retain(|path| !path.is_empty());
    found
}

/// The lower-case path that a text begins with: `wall::echo` of `wall::echo::{Echo, gate}`.
fn path_at(text: &str) -> String {
    let is_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    let mut parts = Vec::new();
    let mut rest = text;
    loop {
        let end = rest.find(|c| !is_name(c)).unwrap_or(rest.len());
        let (name, after) = rest.split_at(end);
        if name.is_empty() || after.starts_with(|c: char| c.is_ascii_uppercase()) {
            // `Error` and `Result` at the root of the crate.
            if parts.is_empty() && (text.starts_with("Error") || text.starts_with("Result")) {
                return "error".into();
            }
            break;
        }
        parts.push(name);
        match after.strip_prefix("::") {
            Some(next) => rest = next,
            None => break,
        }
    }
    parts.join("::")
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(sources(&path));
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// Every import of the crate's own modules, as module paths.
fn imports() -> Vec<Import> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut imports = Vec::new();
    for file in sources(&root) {
        let module = module_of(&file, &root);
        if module == "lib" || module == "main" {
            continue;
        }
        let text = std::fs::read_to_string(&file).unwrap();
        imports.extend(named_paths(&text, &module).into_iter().map(|path| (module.clone(), path)));
    }
    assert!(imports.len() > 300, "{} imports found", imports.len());
    imports
}

#[test]
fn no_module_imports_from_one_above_it() {
    let faults: Vec<String> = imports().iter().filter_map(fault).collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn an_import_from_above_is_told() {
    let import = |from: &str, to: &str| (from.to_owned(), to.to_owned());
    assert!(fault(&import("evaluate::region", "simulate::centreline")).is_some());
    assert!(fault(&import("sweep::wall::engine", "cylinders::fit")).is_some());
    assert!(fault(&import("sweep::wall::grid", "sweep")).is_some());
    assert!(fault(&import("recording", "nowhere")).is_some());
    assert!(fault(&import("simulate::vessel", "evaluate")).is_none());
    let text = "use crate::simulate::Centreline;\nuse crate::{Error, Result, output};\nuse super::super::sweep::Axis;\n\
                // use crate::cli;\n#[cfg(test)]\nmod tests {\n    use crate::study;\n}\n";
    let found: Vec<String> = named_paths(text, "evaluate::region").into_iter().collect();
    assert_eq!(found, ["error", "output", "simulate", "sweep"]);
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let modules: BTreeSet<String> = sources(&root).iter().map(|file| module_of(file, &root)).collect();
    let mut edges: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (from, to) in imports() {
        let mut to = to.as_str();
        while !modules.contains(to) {
            let Some((parent, _)) = to.rsplit_once("::") else { break };
            to = parent;
        }
        // A folder's face and the files in it know each other.
        let is_family = from.starts_with(&format!("{to}::")) || to.starts_with(&format!("{from}::"));
        if modules.contains(to) && to != from && !is_family {
            edges.entry(from).or_default().insert(to.to_owned());
        }
    }
    for start in edges.keys() {
        let (mut reached, mut open) = (BTreeSet::new(), vec![start]);
        while let Some(here) = open.pop() {
            for next in edges.get(here).into_iter().flatten() {
                assert_ne!(next, start, "{start} imports itself by way of {here}");
                if reached.insert(next) {
                    open.push(next);
                }
            }
        }
    }
}
