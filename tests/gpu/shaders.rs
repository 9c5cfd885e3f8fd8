//! Shaders, pass tables and twins agree: files, bindings, layouts and constants.

use lumenmesh::low_level::cylinders::gpu::{LANES, PASSES};
use lumenmesh::low_level::cylinders::passes::{
    DeviceCylinder, DevicePair, FitParameters, LIST_HEAD, NONE, TriangleStatistic,
};
use lumenmesh::low_level::gpu::{Access, Shader};
use lumenmesh::low_level::sweep;
use lumenmesh::settings::{Outliers, Settings, Statistic};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, Expression, Handle, Literal, Module, StorageAccess, TypeInner};
use std::collections::{BTreeMap, BTreeSet};
use std::mem::offset_of;
use std::path::{Path, PathBuf};

/// The passes of the cylinders' fit, and those of the sweep.
fn fit() -> impl Iterator<Item = &'static Shader> {
    PASSES.iter().map(|pass| &pass.shader)
}

fn sweep() -> impl Iterator<Item = &'static Shader> {
    sweep::gpu::PASSES.iter().map(|pass| &pass.shader)
}

fn module(pass: &Shader) -> Module {
    let source = pass.source();
    let module = naga::front::wgsl::parse_str(&source)
        .unwrap_or_else(|error| panic!("{}: {}", pass.name, error.emit_to_string(&source)));
    // No capability beyond the standard's, but for passes that a device without subgroups does not get.
    let capabilities = if pass.subgroups { Capabilities::SUBGROUP } else { Capabilities::empty() };
    Validator::new(ValidationFlags::all(), capabilities)
        .subgroup_stages(naga::valid::ShaderStages::COMPUTE)
        .subgroup_operations(naga::valid::SubgroupOperationSet::all())
        .validate(&module)
        .unwrap_or_else(|error| panic!("{}: {}", pass.name, error.emit_to_string(&source)));
    module
}

fn row(name: &str) -> &'static Shader {
    fit().chain(sweep()).find(|pass| pass.name == name).unwrap()
}

fn wgsl_files(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut files: Vec<PathBuf> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "wgsl"))
        .collect();
    files.sort();
    assert!(!files.is_empty(), "no shader in {}", folder.display());
    files
}

/// A file's path from the top of the repository, with `/`.
fn from_top(file: &Path) -> String {
    let path = file.strip_prefix(env!("CARGO_MANIFEST_DIR")).unwrap();
    path.iter().map(|part| part.to_str().unwrap()).collect::<Vec<_>>().join("/")
}

#[test]
fn every_shader_file_is_a_pass_or_part_of_one_and_valid() {
    for (folder, passes) in
        [("shaders/cylinders", fit().collect::<Vec<_>>()), ("shaders/sweep", sweep().collect())]
    {
        let files = wgsl_files(folder);
        for file in &files {
            let name = file.file_stem().unwrap().to_str().unwrap();
            let rows: Vec<_> = passes.iter().filter(|pass| pass.file == name).collect();
            assert!(!rows.is_empty(), "{} is in no row of PASSES", file.display());
            for pass in rows {
                assert_eq!(pass.own_source, std::fs::read_to_string(file).unwrap());
                module(pass);
            }
        }
        let named: BTreeSet<_> = passes.iter().map(|pass| pass.file).collect();
        assert_eq!(named.len(), files.len());
        for file in wgsl_files(&format!("{folder}/common")) {
            assert_used(&file, &passes);
        }
    }
    for file in wgsl_files("shaders/common") {
        assert_used(&file, &fit().chain(sweep()).collect::<Vec<_>>());
    }
}

fn assert_used(common: &Path, passes: &[&Shader]) {
    let text = std::fs::read_to_string(common).unwrap();
    let used = passes.iter().any(|pass| pass.common.contains(&text.as_str()));
    assert!(used, "no pass uses {}", common.display());
}

/// Folders of shaders, and the folders of their twins in Rust.
const TWINS: [(&str, &str); 5] = [
    ("shaders/common", "src/numerics"),
    ("shaders/cylinders/common", "src/cylinders/passes"),
    ("shaders/cylinders", "src/cylinders/passes"),
    ("shaders/sweep/common", "src/sweep/wall/passes"),
    ("shaders/sweep", "src/sweep/wall/passes"),
];

/// Shaders without a twin, and the reason.
const WITHOUT_TWIN: [(&str, &str); 11] = [
    ("shaders/cylinders/common/point_key.wgsl", "it puts a distance and its key together"),
    ("shaders/cylinders/common/listing.wgsl", "it is a part of passes whose twin lists faces"),
    ("shaders/cylinders/common/points.wgsl", "it is a part of bin and scatter"),
    ("shaders/cylinders/group_few.wgsl", "it does what bin, the prefix sums and scatter do"),
    ("shaders/cylinders/common/eight_keys.wgsl", "it is a part of the passes over faces with few points"),
    ("shaders/cylinders/common/statistic.wgsl", "it is a part of the passes over faces, whose twins have it"),
    ("shaders/cylinders/measure_narrow.wgsl", "it does what measure_long does, with other invocations"),
    ("shaders/cylinders/measure_few.wgsl", "it does what measure_short does, with other invocations"),
    ("shaders/sweep/common/climb.wgsl", "it keeps in registers what the CPU reads again"),
    ("shaders/common/dispatch.wgsl", "it numbers workgroups, which the CPU does not have"),
    (
        "shaders/cylinders/measure_short_shared.wgsl",
        "it is measure_short where invocations exchange values otherwise",
    ),
];

#[test]
fn every_shader_file_has_a_twin_of_its_name() {
    for (shaders, twins) in TWINS {
        for file in wgsl_files(shaders) {
            let name = file.file_stem().unwrap().to_str().unwrap();
            let twin = Path::new(env!("CARGO_MANIFEST_DIR")).join(twins).join(format!("{name}.rs"));
            let excepted = WITHOUT_TWIN.iter().any(|(without, _)| *without == from_top(&file));
            assert!(twin.is_file() != excepted, "{} and {}", file.display(), twin.display());
        }
    }
    for (without, _) in WITHOUT_TWIN {
        assert!(Path::new(env!("CARGO_MANIFEST_DIR")).join(without).is_file(), "{without} is gone");
    }
}

#[test]
fn a_shader_with_a_mistake_is_refused() {
    let broken = row("bin").source().replace("let slot =", "let slot: f32 =");
    let refused = match naga::front::wgsl::parse_str(&broken) {
        Err(_) => true,
        Ok(module) => {
            Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).is_err()
        }
    };
    assert!(refused);
}

#[test]
fn bindings_are_those_of_the_pass_table() {
    for pass in fit().chain(sweep()) {
        let module = module(pass);
        let mut found = BTreeMap::new();
        for (_, variable) in module.global_variables.iter() {
            let Some(binding) = &variable.binding else { continue };
            assert_eq!(binding.group, 0, "{}", pass.name);
            let access = match variable.space {
                AddressSpace::Uniform => Access::Uniform,
                AddressSpace::Storage { access } if access.contains(StorageAccess::STORE) => Access::Write,
                AddressSpace::Storage { .. } => Access::Read,
                other => panic!("{}: {other:?}", pass.name),
            };
            found.insert(binding.binding, (variable.name.clone().unwrap(), access));
        }
        let expected: BTreeMap<u32, (String, Access)> =
            (0..).zip(pass.bindings.iter().map(|b| (b.variable.to_owned(), b.access))).collect();
        assert_eq!(found, expected, "{}", pass.name);
    }
}

#[test]
fn workgroups_are_those_of_the_pass_table_and_fit_the_default_limits() {
    let limits = wgpu::Limits::default();
    for pass in fit().chain(sweep()) {
        let module = module(pass);
        let [entry] = &module.entry_points[..] else { panic!("{}: one entry point", pass.name) };
        assert_eq!((entry.name.as_str(), entry.stage), ("main", naga::ShaderStage::Compute));
        match pass.constants.iter().find(|(name, _)| *name == "THREADS") {
            Some(&(_, threads)) => {
                assert!(entry.workgroup_size_overrides.is_some_and(|[x, _, _]| x.is_some()), "{}", pass.name);
                assert_eq!(f64::from(pass.workgroup_size), threads, "{}", pass.name);
            }
            None => {
                assert_eq!(entry.workgroup_size, [pass.workgroup_size, 1, 1], "{}", pass.name);
                assert!(entry.workgroup_size_overrides.is_none());
            }
        }
        // A pass that does without is used where a device has no such workgroups.
        let most = if pass.name.ends_with("_wide") { 1024 } else { 256 };
        assert!(pass.workgroup_size <= most && limits.max_compute_invocations_per_workgroup >= 256);

        let stored = pass.bindings.iter().filter(|b| b.access != Access::Uniform).count();
        assert!(stored <= limits.max_storage_buffers_per_shader_stage.min(8) as usize, "{}", pass.name);

        let memory: u32 = module
            .global_variables
            .iter()
            .filter(|(_, variable)| variable.space == AddressSpace::WorkGroup)
            // Each variable may be padded to 16 bytes.
            .map(|(_, variable)| module.types[variable.ty].inner.size(module.to_ctx()).next_multiple_of(16))
            .sum();
        println!("{}: {memory} bytes of workgroup memory", pass.name);
        assert!(memory <= limits.max_compute_workgroup_storage_size.min(16 * 1024), "{}", pass.name);
    }
    assert_eq!(limits.max_compute_workgroups_per_dimension, 65_535);
}

#[test]
fn pipeline_constants_are_those_of_the_pass_table() {
    for pass in fit().chain(sweep()) {
        let module = module(pass);
        let found: BTreeSet<_> = module.overrides.iter().map(|(_, o)| o.name.as_deref().unwrap()).collect();
        let variants = pass.variants.iter().map(|(name, _)| *name);
        let given: BTreeSet<_> = pass.constants.iter().map(|(name, _)| *name).chain(variants).collect();
        assert_eq!(found, given, "{}", pass.name);
    }
    for (pass, other, constant) in [
        ("bin", "bin_few", "FEW"),
        ("measure_short", "measure_middle", "MIDDLE"),
        ("measure_short_shared", "measure_middle_shared", "MIDDLE"),
        ("measure_long", "measure_long_keyed", "KEYED"),
    ] {
        let of = |name: &str| {
            row(name).constants.iter().find(|(name, _)| *name == constant).map(|(_, value)| *value)
        };
        assert_eq!((of(pass), of(other)), (Some(0.0), Some(1.0)));
    }
}

/// Size and the members' offsets of a structure.
fn layout(module: &Module, name: &str) -> (u32, Vec<(String, u32)>) {
    let (_, ty) = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).unwrap();
    let TypeInner::Struct { members, span } = &ty.inner else { panic!("{name} is no structure") };
    (*span, members.iter().map(|m| (m.name.clone().unwrap(), m.offset)).collect())
}

macro_rules! fields {
    ($type:ty: $($field:ident),*) => {
        (size_of::<$type>() as u32, vec![$((stringify!($field).to_owned(), offset_of!($type, $field) as u32)),*])
    };
}

#[test]
fn structures_have_the_same_layout() {
    let parameters = fields!(FitParameters: nodes, levels, faces, node_count, cylinders, slots, outliers, statistic,
        half_height, step_theta, step_z, faces_per_rad, faces_per_mm, single, max_short, max_middle, max_narrow,
        most_long, pairs, window, last);
    let cylinder = fields!(DeviceCylinder: gate_low, gate_high, scale, unit);
    for pass in fit() {
        assert_eq!(layout(&module(pass), "FitParameters"), parameters, "{}", pass.name);
    }
    assert_eq!(layout(&module(row("project")), "Cylinder"), cylinder);
    // As `TriangleStatistic::support_words` writes it.
    let support = (8, vec![("kept".to_owned(), 0), ("residual".to_owned(), 4)]);
    assert_eq!(layout(&module(row("support")), "TriangleSupport"), support);

    // A vector of three numbers is three numbers in the shader, where its own would be aligned to 16 bytes.
    let flat = |fields: Vec<(String, u32)>, vector: &str, names: [&str; 3]| {
        let places =
            |offset| names.into_iter().zip([0, 4, 8]).map(move |(n, at)| (n.to_owned(), offset + at));
        let of = |(name, offset): (String, u32)| match name == vector {
            true => places(offset).collect::<Vec<_>>(),
            false => vec![(name, offset)],
        };
        fields.into_iter().flat_map(of).collect::<Vec<_>>()
    };
    let (size, fields) =
        fields!(sweep::passes::DeviceEcho: ring, ring_part, node, node_part, rise, step, normal);
    let echo = (size, flat(fields, "normal", ["normal_x", "normal_y", "normal_z"]));
    let state = fields!(sweep::passes::State: prefix, rank, digits, done, steps, residual_square,
        max_residual_square);
    let next_step = fields!(sweep::passes::NextStep: ends, square, beta);
    let level = fields!(sweep::passes::Level: rings, nodes, count, first, coarser, along, around, twist);
    let job = fields!(sweep::passes::WallParameters: rings, nodes, node_count, echoes, project, gated, step,
        arc, start, step_theta, in_plane, noise, per_noise, max_projection, gate, gate_radii, huber, weight_scale,
        weight_unit, rhs_scale, rhs_unit, along, around, twist, tolerance_square, max_steps,
        slope_nodes, slope_rings,
        first_relaxation, second_relaxation, low_tiles);
    for pass in self::sweep() {
        let module = module(pass);
        assert_eq!(layout(&module, "WallParameters"), job, "{}", pass.name);
        assert_eq!(layout(&module, "Echo"), echo, "{}", pass.name);
        assert_eq!(layout(&module, "State"), state, "{}", pass.name);
        assert_eq!(layout(&module, "NextStep"), next_step, "{}", pass.name);
        assert_eq!(layout(&module, "Level"), level, "{}", pass.name);
    }

    let (size, fields) = layout(&module(row("project")), "Pair");
    assert_eq!(size as usize, size_of::<DevicePair>());
    let mut expected = Vec::new();
    for (name, offset) in [
        ("x", offset_of!(DevicePair, x)),
        ("y", offset_of!(DevicePair, y)),
        ("origin", offset_of!(DevicePair, origin)),
    ] {
        for (axis, place) in ["x", "y", "z"].into_iter().zip(0..) {
            expected.push((format!("{name}_{axis}"), offset as u32 + 4 * place));
        }
    }
    for (name, offset) in [
        ("cylinder", offset_of!(DevicePair, cylinder)),
        ("first_point", offset_of!(DevicePair, first_point)),
        ("count", offset_of!(DevicePair, count)),
        ("first_slot", offset_of!(DevicePair, first_slot)),
    ] {
        expected.push((name.to_owned(), offset as u32));
    }
    for place in 0..3 {
        expected.push((format!("unused_{place}"), offset_of!(DevicePair, unused) as u32 + 4 * place));
    }
    assert_eq!(fields, expected);
}

fn literal(module: &Module, expression: Handle<Expression>) -> u32 {
    match module.global_expressions[expression] {
        Expression::Literal(Literal::U32(value)) => value,
        ref other => panic!("{other:?}"),
    }
}

fn constant(module: &Module, name: &str) -> u32 {
    let (_, constant) = module.constants.iter().find(|(_, c)| c.name.as_deref() == Some(name)).unwrap();
    literal(module, constant.init)
}

#[test]
fn constants_are_those_of_rust() {
    let parameters = |outliers, statistic| {
        let settings = Settings::default().with_outliers(outliers).with_statistic(statistic);
        FitParameters::new(&settings, 1, 0, None, [4, 32])
    };
    let shader = module(row("measure_long"));
    for (name, outliers) in [
        ("OUTLIERS_IQR", Outliers::Iqr),
        ("OUTLIERS_DEVIATION", Outliers::Deviation),
        ("OUTLIERS_NONE", Outliers::None),
    ] {
        assert_eq!(constant(&shader, name), parameters(outliers, Statistic::Mean).outliers);
    }
    for (name, statistic) in [("STATISTIC_MEAN", Statistic::Mean), ("STATISTIC_MEDIAN", Statistic::Median)] {
        assert_eq!(constant(&shader, name), parameters(Outliers::Iqr, statistic).statistic);
    }
    assert_eq!(constant(&module(row("measure_narrow")), "THREADS"), row("measure_narrow").workgroup_size);
    assert_eq!(constant(&shader, "NONE"), NONE);
    assert_eq!(constant(&shader, "FIRST_LISTED") as usize, LIST_HEAD);
    assert_eq!(constant(&shader, "NO_VALUE"), TriangleStatistic::<f32>::default().value_word());
}

#[test]
fn the_number_of_a_face_s_points_and_their_sizes_fit_one_word() {
    for name in ["measure_short", "measure_short_shared"] {
        let module = module(row(name));
        let (_, lanes) = module.overrides.iter().find(|(_, o)| o.name.as_deref() == Some("LANES")).unwrap();
        assert!(LANES.contains(&literal(&module, lanes.init.unwrap())));
        assert_eq!(constant(&module, "THREADS"), row(name).workgroup_size);
        for lanes in LANES {
            assert_eq!(row(name).workgroup_size % lanes, 0);
            let capacity = FitParameters::new(&Settings::default(), 1, 0, None, [lanes, 0]).max_short;
            // Eight keys an invocation.
            assert_eq!(capacity, 8 * lanes);
            // The upper 15 bits of each size, and a bit of its own for each that is kept.
            let one_kept = constant(&module, "ONE_KEPT");
            assert!(capacity * ((1 << 15) - 1) < one_kept && capacity.checked_mul(one_kept).is_some());
        }
        assert_eq!(constant(&module, "EMPTY"), u32::MAX);
    }
}
