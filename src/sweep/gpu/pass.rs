//! The passes of the wall's fit on the device: what each binds and what its workgroups are for, written once.

use crate::gpu::{Access, Shader};

/// What a pass has a workgroup or an invocation for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Items {
    /// An invocation an echo of a chunk.
    Echoes,
    /// A workgroup for every 4096 echoes of a chunk.
    EchoBlocks,
    /// One workgroup.
    One,
}

/// A row of the pass table.
#[derive(Debug)]
pub struct Pass {
    /// Its text, in `shaders/sweep/`, and what that asks for.
    pub shader: Shader,
    /// What its workgroups are for.
    pub items: Items,
}

const JOB: &str = include_str!("../../../shaders/sweep/common/job.wgsl");
const ECHO: &str = include_str!("../../../shaders/sweep/common/echo.wgsl");
const EXACT: &str = include_str!("../../../shaders/common/exact.wgsl");

macro_rules! pass {
    ($name:literal, $items:ident, $size:literal, [$($common:ident),*],
     [$($binding:literal: $access:ident),* $(,)?]) => {
        Pass {
            shader: Shader {
                name: $name,
                own_source: include_str!(concat!("../../../shaders/sweep/", $name, ".wgsl")),
                common: &[JOB, $($common),*],
                constants: String::new,
                bindings: &[("job", Access::Uniform), $(($binding, Access::$access)),*],
                workgroup_size: $size,
                variants: None,
            },
            items: Items::$items,
        }
    };
}

/// Every pass.
pub static PASSES: [Pass; 4] = [
    pass!("measure", Echoes, 256, [ECHO], ["echoes": Read, "wall": Read, "shifts": Write, "misses": Write]),
    pass!("count_misses", EchoBlocks, 256, [], ["misses": Read, "state": Read, "counts": Write]),
    pass!("pick_digit", One, 256, [], ["counts": Write, "state": Write]),
    pass!("accumulate", Echoes, 256, [ECHO, EXACT], [
        "echoes": Read, "wall": Read, "shifts": Read, "sums_low": Write, "sums_high": Write,
    ]),
];
