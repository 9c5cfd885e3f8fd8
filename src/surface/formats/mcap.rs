//! A mesh for Foxglove: an MCAP file with one `foxglove.SceneUpdate` in JSON, positions in metres. It is
//! written only, and carries no arrays.

use crate::surface::{Space, Surface};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{Cursor, Error, Result, Write};

/// The frame that positions are in, as `FrameTransform` may name it.
const FRAME: &str = "Tracker";
/// What the members are, as far as Foxglove needs it: it knows the schema by its name.
const SCHEMA: &str = r#"{"title": "foxglove.SceneUpdate", "type": "object",
  "properties": {"deletions": {"type": "array"}, "entities": {"type": "array", "items": {"type": "object"}}}}"#;

pub(in crate::surface) fn write(surface: &Surface, space: Space, out: &mut dyn Write) -> Result<()> {
    let point = |p: &glam::DVec3| json!({ "x": p.x / 1000.0, "y": p.y / 1000.0, "z": p.z / 1000.0 });
    let zero = json!({ "sec": 0, "nsec": 0 });
    let none = Value::Array(Vec::new());
    let scene = json!({
        "deletions": none,
        "entities": [{
            "timestamp": zero, "frame_id": FRAME, "id": "lumen", "lifetime": zero, "frame_locked": true,
            "metadata": [{ "key": "space", "value": space.to_string() }],
            "arrows": none, "cubes": none, "spheres": none, "cylinders": none, "lines": none, "texts": none, "models": none,
            "triangles": [{
                "pose": { "position": { "x": 0, "y": 0, "z": 0 }, "orientation": { "x": 0, "y": 0, "z": 0, "w": 1 } },
                "points": surface.nodes_mm.iter().map(point).collect::<Vec<_>>(),
                "color": { "r": 0.8, "g": 0.3, "b": 0.25, "a": 1.0 },
                "colors": none,
                "indices": surface.triangles.as_flattened(),
            }],
        }],
    });
    let mut file = Cursor::new(Vec::new());
    let other = |e: mcap::McapError| Error::other(e);
    let options = mcap::WriteOptions::new().library("lumenmesh").compression(Some(mcap::Compression::Lz4));
    let mut writer = options.create(&mut file).map_err(other)?;
    let schema = writer.add_schema("foxglove.SceneUpdate", "jsonschema", SCHEMA.as_bytes()).map_err(other)?;
    let channel = writer.add_channel(schema, "/lumen", "json", &BTreeMap::new()).map_err(other)?;
    let header =
        mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 0, publish_time: 0 };
    writer.write_to_known_channel(&header, scene.to_string().as_bytes()).map_err(other)?;
    writer.finish().map_err(other)?;
    drop(writer);
    out.write_all(&file.into_inner())
}
