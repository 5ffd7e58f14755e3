import sys,collections,struct
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
pub={'foxglove.PointCloud':PointCloud,'foxglove.FrameTransform':FrameTransform,'foxglove.Log':Log}
f=open(sys.argv[1],'rb'); r=make_reader(f,decoder_factories=[DecoderFactory()])
s=r.get_summary(); print('messages',s.statistics.message_count,'chunks',s.statistics.chunk_count,'attachments',s.statistics.attachment_count,'metadata',s.statistics.metadata_count)
n=collections.Counter(); frames=set(); pts=[]
for schema,ch,m in r.iter_messages():
    n[(ch.topic,ch.message_encoding,schema.name if schema else None)]+=1
    if schema and schema.name in pub:
        msg=pub[schema.name](); msg.ParseFromString(m.data); assert msg.SerializeToString()==m.data, schema.name
        if ch.topic=='/view/cloud': pts.append(len(msg.data)//msg.point_stride); frames.add(msg.frame_id)
for schema,ch,m,d in r.iter_decoded_messages(topics=['/tf']): last=d
for k,v in sorted(n.items(),key=str): print(v,k)
print(len(frames),'frames',min(pts),max(pts)); print(last.parent_frame_id,last.child_frame_id,last.translation.x)
for a in r.iter_attachments(): print(a.name,len(a.data))
for m in r.iter_metadata(): print(m.name,{k:v[:60] for k,v in m.metadata.items()})
