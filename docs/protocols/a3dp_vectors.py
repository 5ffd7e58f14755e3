#!/usr/bin/env python3
"""Prints the vectors of camera.md: one frame of each A3DP/1 message in hex. Plain Python 3, no packages.

A third reading of the page, beside the client's and the simulator's. To renew the page:
    sed -i '/^`hello`: /,$d' camera.md && python3 a3dp_vectors.py >> camera.md
"""
import struct

NAN = float("nan")
NONE = 0xFFFFFFFFFFFFFFFF


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def frame(kind, payload, request_id=0, seq=0, flags=0):
    head = b"A3DP" + struct.pack("<BBHIIIHHI", 1, 32, kind, len(payload), request_id, seq, flags, 0, crc32c(payload))
    return head + struct.pack("<I", crc32c(head)) + payload


def str8(text):
    return struct.pack("<B", len(text.encode())) + text.encode()


def str16(text):
    return struct.pack("<H", len(text.encode())) + text.encode()


def tlv(tag, value):
    return struct.pack("<HH", tag, len(value)) + value


SETTINGS = [
    tlv(0x8001, struct.pack("<B", 1)),
    tlv(0x8002, struct.pack("<6H", 1440, 1080, 0, 0, 0, 0)),
    tlv(0x8003, struct.pack("<I", 1000)),
    tlv(0x8004, struct.pack("<H", 24)),
    tlv(0x8005, struct.pack("<II", 0, 0)),
    tlv(0x8006, struct.pack("<B", 1)),
    tlv(0x8007, struct.pack("<B", 25)),
    tlv(0x8008, struct.pack("<f", 2.0)),
    tlv(0x8009, struct.pack("<f", 0.85)),
    tlv(0x800A, struct.pack("<B", 1)),
    tlv(0x800B, struct.pack("<B", 5)),
    tlv(0x800C, struct.pack("<B", 3)),
    tlv(0x800D, struct.pack("<B", 1)),
    tlv(0x800E, struct.pack("<B3x6f", 0, 0, 0, 0, 0, 0, 0)),
    tlv(0x800F, struct.pack("<I", 0b10101)),
]
TRIGGER_ID = 5 << 16 | 1

# A frame of 2 x 1 pixels, XYZ (24 bytes) + INTENSITY (2) + MASK (2); the second pixel is invalid.
XYZ = struct.pack("<6f", 1.0, -2.0, 300.5, NAN, NAN, NAN)
INTENSITY = bytes([200, 10])
MASK = bytes([0, 9])
COMPONENTS = [(0, 0x026000C0, 24, XYZ), (2, 0x01080001, 2, INTENSITY), (4, 0x01080001, 2, MASK)]

frame_begin = struct.pack(
    "<QQIIQQQBBBBIIIHHHHQ6dII4fHHI",
    9, TRIGGER_ID, 5, 77, 1_000_000, 2_000_000, 3_000_000, 0, 1, 1, 0, 1 | 1 << 8 | 1 << 11, 2, 1,
    0, 0, 0, 0, 4242, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1, 0, 35.5, 30.0, 30.25, NAN, 3, 32, 0,
) + b"".join(struct.pack("<HHIIIQQ", kind, 0, fmt, stride, 1, len(data), 0) for kind, fmt, stride, data in COMPONENTS)


def chunk(index):
    return struct.pack("<QHHIQ", 9, index, 0, 0, 0) + COMPONENTS[index][3]


frame_end = struct.pack("<QQB3xIHH", 9, TRIGGER_ID, 0, 1, 3, 0) + b"".join(
    struct.pack("<QII", len(data), crc32c(data), 0) for _, _, _, data in COMPONENTS)

VECTORS = [
    ("hello", "client, first frame", frame(0x01, struct.pack("<5B3xQ", 1, 0, 1, 0, 1, 0xB1ADE5CA00000001) + str8("bladescan"), 1, 0)),
    ("hello_ok", "its answer, the server's first frame",
     frame(0x02, struct.pack("<4BIQQIIIIQ", 1, 0, 1, 1, 7, 0x1122334455667788, 4242, 20261121, 1_000_000_000, 65536, 1048576,
                             67108864)
           + str8("bladescan") + str8("SIMULATED A5000") + str8("SIM-0001") + str8("0.1.0") + str8("none"), 1, 0, 1)),
    ("get_caps", "", frame(0x03, b"", 2, 1)),
    ("caps", "optics fine",
     frame(0x04, struct.pack("<6H3I3H4BH4f9f4I", 1440, 1080, 80, 4, 8, 4, 10, 50000, 1000, 12, 60, 24, 100, 25, 2, 0, 0,
                             200.0, 260.0, 320.0, 0.04, 0, 0, 0, 100, 0, 0, 50, 0, 0, 0b10101, 0b1111, 0b1111, 0b11)
           + str8("fine"), 2, 1, 1)),
    ("configure", "the whole settings, binned", frame(0x10, b"".join(SETTINGS), 3, 2)),
    ("configured", "echo, ascending tags",
     frame(0x11, struct.pack("<IIIQ", 77, 108000, 208000, 5443200) + b"".join(SETTINGS), 3, 2, 1)),
    ("arm", "software trigger", frame(0x12, struct.pack("<B3xI", 1, 77), 4, 3)),
    ("armed", "", frame(0x14, struct.pack("<B3x", 2), 4, 3, 1)),
    ("disarm", "", frame(0x13, b"", 6, 5)),
    ("disarmed", "", frame(0x15, struct.pack("<B3x", 1), 6, 20, 1)),
    ("trigger", "view 5, attempt 1",
     frame(0x20, struct.pack("<QIII", TRIGGER_ID, 5, 77, 15000) + str8("view 5"), 5, 4)),
    ("trigger_ok", "", frame(0x21, struct.pack("<QB3xII", TRIGGER_ID, 0, 108000, 208000), 5, 4, 1)),
    ("exposure_done", "", frame(0x22, struct.pack("<QQQ", TRIGGER_ID, 1_000_000, 2_000_000), 0, 5)),
    ("frame_begin", "2 x 1 pixels, XYZ, INTENSITY, MASK", frame(0x30, frame_begin, 0, 6)),
    ("frame_chunk_0", "XYZ", frame(0x31, chunk(0), 0, 7)),
    ("frame_chunk_1", "INTENSITY", frame(0x31, chunk(1), 0, 8)),
    ("frame_chunk_2", "MASK", frame(0x31, chunk(2), 0, 9)),
    ("frame_end", "", frame(0x32, frame_end, 0, 10, 4)),
    ("fetch", "after a lost connection", frame(0x33, struct.pack("<Q", TRIGGER_ID), 10, 9)),
    ("fetch_ok", "in flight", frame(0x34, struct.pack("<QB3xI", TRIGGER_ID, 1, 90000), 10, 25, 1)),
    ("abort", "all", frame(0x40, struct.pack("<Q", NONE), 7, 6)),
    ("aborted", "caught while exposing", frame(0x41, struct.pack("<QB3x", TRIGGER_ID, 2), 7, 21, 1)),
    ("get_status", "", frame(0x50, b"", 8, 7)),
    ("status", "by itself",
     frame(0x51, struct.pack("<BBH4f8IHH", 2, 0, 0, 35.5, 30.0, 30.25, NAN, 2400, 2400, 6, 6, 0, 0, 0, 1000, 0, 0), 0, 22)),
    ("event", "cool-down pause", frame(0x52, struct.pack("<HHQQI", 5, 0, NONE, 5_000_000, 200) + str16("LED pause 200 ms"), 0, 23)),
    ("ping", "from the client", frame(0x60, struct.pack("<Q", 123456789), 9, 8)),
    ("pong", "from the server", frame(0x61, struct.pack("<QQQ", 123456789, 6_000_000, 7_000_000), 9, 24, 1)),
    ("error", "a trigger refused: not armed",
     frame(0x70, struct.pack("<IQHBBIi", 5, TRIGGER_ID, 202, 1, 1, 0, 0) + str16("not armed"), 5, 25, 3)),
    ("bye", "done", frame(0x7F, struct.pack("<H", 1) + str8("done"), 0, 9)),
]

if __name__ == "__main__":
    for name, note, data in VECTORS:
        print(f"`{name}`" + (f": {note}" if note else ""))
        print(f"\n```hex {name}")
        for start in range(0, len(data), 32):
            print(data[start:start + 32].hex(" ", 4))
        print("```" if name == VECTORS[-1][0] else "```\n")
