#!/usr/bin/env python3
"""Prints camera_example.md: a whole A3DP/1 exchange, every byte named. Plain Python 3, no packages.

    python3 a3dp_example.py > camera_example.md
"""
import struct

from a3dp_vectors import VECTORS

HEADER = [("4s", "magic"), ("B", "major"), ("B", "header_len"), ("H", "type"), ("I", "payload_len"), ("I", "request_id"),
          ("I", "seq"), ("H", "flags"), ("H", "reserved"), ("I", "payload_crc"), ("I", "header_crc")]
SETTINGS = [("B", "binning"), ("6H", "roi"), ("I", "exposure_us"), ("H", "image_count"), ("2I", "hdr: low_us, high_us"),
            ("B", "compression"), ("B", "led_percent"), ("f", "frame_time_ratio"), ("f", "score_threshold"),
            ("B", "outlier_filter"), ("B", "reconstruction_quality"), ("B", "pre_filtering"), ("B", "working_volume"),
            ("B3s6f", "volume_of_interest: on, reserved, min_mm, max_mm"), ("I", "components")]
RECORDS = [field for code, name in SETTINGS for field in (("H", "tag"), ("H", "length"), (code, name))]
ENTRY = [("H", "kind"), ("H", "reserved"), ("I", "format"), ("I", "row_stride_bytes"), ("I", "chunk_count"),
         ("Q", "byte_count"), ("Q", "reserved")]
FIELDS = {
    "hello": [("B", "min_major"), ("B", "min_minor"), ("B", "max_major"), ("B", "max_minor"), ("B", "role"), ("3s", "reserved"),
              ("Q", "run_id"), ("str8", "client_name")],
    "hello_ok": [("B", "major"), ("B", "minor"), ("B", "role"), ("B", "simulated"), ("I", "session_id"), ("Q", "boot_id"),
                 ("Q", "calibration_id"), ("I", "calibration_date"), ("I", "clock_hz"), ("I", "control_payload_max"),
                 ("I", "chunk_payload_max"), ("Q", "frame_bytes_max"), ("str8", "vendor"), ("str8", "model"), ("str8", "serial"),
                 ("str8", "firmware"), ("str8", "sdk_version")],
    "get_caps": [],
    "caps": [("H", "sensor_width_px"), ("H", "sensor_height_px"), ("H", "roi_width_min_px"), ("H", "roi_height_min_px"),
             ("H", "roi_x_step_px"), ("H", "roi_y_step_px"), ("I", "exposure_min_us"), ("I", "exposure_max_us"),
             ("I", "exposure_default_us"), ("H", "image_count_min"), ("H", "image_count_max"), ("H", "image_count_default"),
             ("B", "led_max_percent"), ("B", "led_recommended_percent"), ("B", "hdr_slot_count"), ("B", "hdr_in_free_run"),
             ("H", "reserved"), ("f", "near_mm"), ("f", "nominal_mm"), ("f", "far_mm"), ("f", "spacing_mm"), ("3f", "camera_1_mm"),
             ("3f", "camera_2_mm"), ("3f", "projector_mm"), ("I", "components"), ("I", "outlier_filters"), ("I", "compressions"),
             ("I", "working_volumes"), ("str8", "optics")],
    "configure": RECORDS,
    "configured": [("I", "config_id"), ("I", "predicted_exposure_us"), ("I", "predicted_total_us"), ("Q", "frame_bytes")] + RECORDS,
    "arm": [("B", "mode"), ("3s", "reserved"), ("I", "config_id")],
    "armed": [("B", "state"), ("3s", "reserved")],
    "trigger": [("Q", "trigger_id"), ("I", "view_id"), ("I", "config_id"), ("I", "deadline_ms"), ("str8", "tag")],
    "trigger_ok": [("Q", "trigger_id"), ("B", "repeated"), ("3s", "reserved"), ("I", "predicted_exposure_us"),
                   ("I", "predicted_total_us")],
    "exposure_done": [("Q", "trigger_id"), ("Q", "exposure_begin_ns"), ("Q", "exposure_end_ns")],
    "frame_begin": [("Q", "frame_id"), ("Q", "trigger_id"), ("I", "view_id"), ("I", "config_id"), ("Q", "exposure_begin_ns"),
                    ("Q", "exposure_end_ns"), ("Q", "reconstruction_end_ns"), ("B", "clock_id"), ("B", "unit"), ("B", "axes"),
                    ("B", "reserved"), ("I", "frame_flags"), ("I", "width_px"), ("I", "height_px"), ("2H", "camera_1_px"),
                    ("2H", "camera_2_px"), ("Q", "calibration_id"), ("3d", "scale"), ("3d", "offset"), ("I", "valid_count"),
                    ("I", "saturated_count"), ("4f", "temperature_c"), ("H", "component_count"), ("H", "entry_len"),
                    ("I", "reserved")] + 3 * ENTRY,
    "frame_chunk": [("Q", "frame_id"), ("H", "component_index"), ("H", "reserved"), ("I", "chunk_index"), ("Q", "offset_bytes")],
    "frame_end": [("Q", "frame_id"), ("Q", "trigger_id"), ("B", "status"), ("3s", "reserved"), ("I", "valid_count"),
                  ("H", "component_count"), ("H", "reserved")] + 3 * [("Q", "byte_count"), ("I", "crc32c"), ("I", "reserved")],
    "disarm": [],
    "disarmed": [("B", "state"), ("3s", "reserved")],
    "bye": [("H", "reason"), ("str8", "text")],
}
DATA = {"frame_chunk_0": ("6f", "x, y, z of two pixels"), "frame_chunk_1": ("2B", "intensity of two pixels"),
        "frame_chunk_2": ("2B", "mask of two pixels")}
CLIENT = {"hello", "get_caps", "configure", "arm", "trigger", "disarm", "bye"}
HEXED = {"type", "flags", "payload_crc", "header_crc", "run_id", "boot_id", "tag", "format", "crc32c", "frame_flags", "components",
         "outlier_filters", "compressions", "working_volumes", "trigger_id"}


def value_of(code, name, data):
    if code == "str8":
        return f'{data[0]} bytes, "{data[1:].decode()}"'
    values = struct.unpack("<" + code, data)
    if name == "magic":
        return "A3DP"
    words = [f"{v:#x}" if name in HEXED and isinstance(v, int) else "0" if isinstance(v, bytes) else f"{v:.7g}" if isinstance(v, float)
             else str(v) for v in values]
    return ", ".join(words)


def rows(fields, data, at):
    for code, name in fields:
        size = 1 + data[at] if code == "str8" else struct.calcsize("<" + code)
        piece = data[at:at + size]
        shown = piece.hex(" ") if size <= 28 else piece[:24].hex(" ") + " …"
        yield f"| {at} | `{shown}` | {name} | {value_of(code, name, piece)} |"
        at += size
    assert at == len(data), (at, len(data))


print("""# A3DP/1: a whole exchange, byte by byte

Every message of the usual way from the greeting to a frame, for whoever writes a bridge; the page is [camera.md](camera.md).
Made by `a3dp_example.py` from the same vectors that the tests read. Offsets count from the first byte of the header. The frame is
2 × 1 pixels, and the second has no 3D. In a real conversation STATUS, PING and PONG come in between, and the `seq` of these
vectors leaves them room.
""")
known = {name: (note, data) for name, note, data in VECTORS}
for name in ["hello", "hello_ok", "get_caps", "caps", "configure", "configured", "arm", "armed", "trigger", "trigger_ok",
             "exposure_done", "frame_begin", "frame_chunk_0", "frame_chunk_1", "frame_chunk_2", "frame_end", "disarm", "disarmed", "bye"]:
    note, data = known[name]
    sender = "client to server" if name in CLIENT else "server to client"
    fields = FIELDS["frame_chunk"] + [DATA[name]] if name in DATA else FIELDS[name]
    print(f"## {name.rstrip('_012').upper()}{': ' + note if note else ''}\n\n{sender}, {len(data)} bytes\n")
    print("| offset | bytes | field | value |\n|---|---|---|---|")
    print("\n".join(rows(HEADER + fields, data, 0)) + "\n")
