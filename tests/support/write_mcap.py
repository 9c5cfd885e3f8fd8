"""Writes the frames of a .ndjson file as MCAP files, one for each way of writing poses: python write_mcap.py REC FOLDER.

The messages are put together here, byte by byte, so that the reader is not tested with its own eyes.
"""

import json
import struct
import sys
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from scipy.spatial.transform import Rotation

START_NS = 1_700_000_000_000_000_000


def cdr(*values):
    """Little-endian CDR of texts, 4-byte integers and 8-byte floats."""
    out = b""
    for value in values:
        if isinstance(value, str):
            value = value.encode() + b"\0"
            out += b"\0" * (-len(out) % 4) + struct.pack("<I", len(value)) + value
        elif isinstance(value, int):
            out += b"\0" * (-len(out) % 4) + struct.pack("<I", value)
        else:
            out += b"\0" * (-len(out) % 8) + struct.pack("<d", value)
    return b"\0\1\0\0" + out


def varint(value):
    out = b""
    while value >= 0x80:
        out += bytes([value & 0x7F | 0x80])
        value >>= 7
    return out + bytes([value])


def nested(number, content):
    return varint(number << 3 | 2) + varint(len(content)) + content


def doubles(values):
    return b"".join(varint((k + 1) << 3 | 1) + struct.pack("<d", value) for k, value in enumerate(values))


def json_pose(sec, nsec, t, q):
    return json.dumps(
        {
            "timestamp": {"sec": sec, "nsec": nsec},
            "parent_frame_id": "Tracker",
            "child_frame_id": "Probe",
            "translation": dict(zip("xyz", t)),
            "rotation": dict(zip("xyzw", q)),
        }
    ).encode()


def protobuf_pose(sec, nsec, t, q):
    time = varint(8) + varint(sec) + varint(16) + varint(nsec)
    return (
        nested(1, time) + nested(2, b"Tracker") + nested(3, b"Probe") + nested(4, doubles(t)) + nested(5, doubles(q))
    )


KINDS = {
    "json": ("foxglove.FrameTransform", "json", json_pose),
    "protobuf": ("foxglove.FrameTransform", "protobuf", protobuf_pose),
    "tf": ("tf2_msgs/msg/TFMessage", "cdr", lambda s, ns, t, q: cdr(1, s, ns, "Tracker", "Probe", *t, *q)),
    "pose": ("geometry_msgs/msg/PoseStamped", "cdr", lambda s, ns, t, q: cdr(s, ns, "Tracker", *t, *q)),
}


def main(path, folder):
    frames = [json.loads(line) for line in Path(path).read_text().splitlines()]
    compressions = [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD]

    def write(name, kinds, whole=False, compression=CompressionType.ZSTD, offset_ns=0):
        writer = Writer(str(Path(folder) / f"{name}.mcap"), chunk_size=1 << 16, compression=compression)
        writer.start()
        channels = {}
        for kind in kinds:
            schema, encoding, _ = KINDS[kind]
            identity = writer.register_schema(schema, "", b"")
            channels[kind] = writer.register_channel(f"/{kind}", encoding, identity)
        identity = writer.register_schema("lumenmesh.Frame", "jsonschema", b"{}")
        contours = writer.register_channel("/contour", "json", identity)
        identity = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        other = writer.register_channel("/log", "cdr", identity)
        writer.add_message(other, 0, cdr("hello"), 0)
        for frame in frames:
            time_ns = START_NS + round(frame["time_s"] * 1e9)
            stamp = {"timestamp": {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}}
            contour = stamp | {"contour": frame["contour"]} | ({"pose": frame["pose"]} if whole else {})
            # Logged later than it was taken, and before its pose.
            writer.add_message(contours, time_ns + 5_000_000, json.dumps(contour).encode(), time_ns)
            if frame["pose"] is None:
                continue
            matrix = np.array(frame["pose"]).reshape(4, 4)
            t = [float(x) / 1000.0 for x in matrix[:3, 3]]
            q = [float(x) for x in Rotation.from_matrix(matrix[:3, :3]).as_quat()]
            sec, nsec = divmod(time_ns + offset_ns, 10**9)
            for kind, channel in channels.items():
                writer.add_message(channel, time_ns + 9_000_000, KINDS[kind][2](sec, nsec, t, q), time_ns)
        writer.finish()

    for k, kind in enumerate(KINDS):
        write(kind, [kind], compression=compressions[k % 3])
    write("two", ["tf", "pose"])
    write("whole", [], whole=True)
    write("between", ["tf"], offset_ns=20_000_000)


main(*sys.argv[1:])
