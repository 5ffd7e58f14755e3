#!/usr/bin/env python3
"""Opens a recording with Python's mcap and the published Foxglove schemas, and says what is in it.

    check_recording.py RUN.mcap        needs: pip install mcap foxglove-schemas-protobuf

Fails when a protobuf payload is not byte-equal after being read and written by the published message class.
"""
import collections
import sys

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from mcap.reader import make_reader

PUBLISHED = {"foxglove.PointCloud": PointCloud, "foxglove.FrameTransform": FrameTransform, "foxglove.Log": Log}

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file)
    statistics = reader.get_summary().statistics
    print(f"{statistics.message_count} messages in {statistics.chunk_count} chunks")
    counts, clouds, transforms = collections.Counter(), {}, {}
    for schema, channel, message in reader.iter_messages():
        counts[channel.topic, channel.message_encoding, schema.name if schema else "-"] += 1
        if schema and schema.name in PUBLISHED:
            found = PUBLISHED[schema.name]()
            found.ParseFromString(message.data)
            assert found.SerializeToString() == message.data, f"{channel.topic}: not the published message"
            if channel.topic == "/view/cloud":
                clouds[found.frame_id] = len(found.data) // found.point_stride
            if channel.topic == "/tf":
                transforms[found.child_frame_id] = found.parent_frame_id
    for (topic, encoding, schema), count in sorted(counts.items()):
        print(f"{count:7} {topic:18} {encoding:9} {schema}")
    print(f"clouds of {len(clouds)} views with {min(clouds.values())} to {max(clouds.values())} points; "
          f"{len(transforms)} poses, all in {sorted(set(transforms.values()))}")
    print("attachments:", ", ".join(f"{item.name} ({len(item.data)} bytes)" for item in reader.iter_attachments()))
    print("metadata:", ", ".join(item.name for item in reader.iter_metadata()))
