//! What the camera's decoders must bear, shared with the target in `fuzz/`.

use bladescan::camera::{
    Assembly, Capture, CapturedPoints, ClientMessage, Component, ComponentEnd, ComponentKind, FrameBegin, FrameChunk,
    FrameEnd, FrameFlags, FrameReader, FrameStatus, FrameWriter, HEADER_BYTES, ServerMessage, TriggerId, WireFrame,
};
use bladescan::cleaning;

/// Reads a stream of frames as messages of either side, and puts frames of points together. Whether a message was taken.
pub fn frames(bytes: &[u8]) -> bool {
    let mut reader = FrameReader::default();
    let mut assembly = None;
    let mut taken = false;
    let (first, second) = bytes.split_at(bytes.len() / 2);
    for part in [first, second] {
        reader.push(part);
        loop {
            match reader.next_frame() {
                Ok(Some(frame)) => taken |= message(&frame, &mut assembly),
                Ok(None) => break,
                Err(_) => return taken,
            }
        }
    }
    taken
}

fn message(frame: &WireFrame<'_>, assembly: &mut Option<Assembly>) -> bool {
    let of_client = matches!(ClientMessage::decode(frame.kind, frame.payload), Ok(Some(_)));
    let Ok(Some(message)) = ServerMessage::decode(frame.kind, frame.payload) else {
        return of_client;
    };
    match message {
        ServerMessage::FrameBegin(begin) => *assembly = Assembly::begin(*begin, FRAME_BYTES_MAX).ok(),
        ServerMessage::FrameChunk(chunk)
            if assembly.as_mut().is_some_and(|assembly| assembly.push(&chunk).is_err()) =>
        {
            *assembly = None;
        }
        ServerMessage::FrameEnd(end) => {
            if let Some(Ok(capture)) = assembly.take().map(|assembly| assembly.end(&end)) {
                assert!(byte_count(&capture) <= FRAME_BYTES_MAX, "no more is kept than allowed");
                judge(&capture);
            }
        }
        _ => {}
    }
    true
}

/// Cleans a frame whose points are these bytes: a few rows of XYZ or, as the first byte says, of RANGE. Whether a point is
/// left.
pub fn points(bytes: &[u8]) -> bool {
    let Some((first, bytes)) = bytes.split_first() else {
        return false;
    };
    let pixel_bytes = if first & 1 == 0 { 12 } else { 2 };
    let width = 1 + usize::from(first >> 1) % 24;
    let height = bytes.len() / (width * pixel_bytes);
    let bytes = bytes[..width * height * pixel_bytes].to_vec();
    let points = match pixel_bytes {
        12 => CapturedPoints::Xyz(bytes),
        _ => CapturedPoints::Range {
            bytes,
            scale: [0.1, 0.1, 0.01],
            offset: [-1.0, -1.0, 100.0],
        },
    };
    judge(&Capture {
        trigger_id: TriggerId(0),
        width_px: width as u32,
        height_px: height as u32,
        valid_count: 0,
        saturated_count: 0,
        points,
        intensity: None,
        confidence: None,
        mask: vec![0; width * height],
    })
}

fn byte_count(capture: &Capture) -> u64 {
    let (CapturedPoints::Xyz(points) | CapturedPoints::Range { bytes: points, .. }) = &capture.points;
    let others = [&capture.intensity, &capture.confidence].map(|part| part.as_ref().map_or(0, Vec::len));
    (points.len() + others[0] + others[1] + capture.mask.len()) as u64
}

fn judge(capture: &Capture) -> bool {
    let grid = capture.grid();
    let measured_count = grid.point_count();
    let (cloud, removed) = cleaning::clean(grid, &cleaning::Settings::default());
    assert_eq!(cloud.len() + removed.total(), measured_count);
    let normals = cloud.normals().unwrap_or_default();
    assert_eq!(normals.len(), cloud.len());
    for (point, normal) in cloud.points().iter().zip(normals) {
        assert!(point.coords.iter().all(|value| value.is_finite()));
        assert!((normal.norm() - 1.0).abs() < 1e-9, "{normal:?}");
    }
    !cloud.is_empty()
}

pub fn points_seeds() -> Vec<Vec<u8>> {
    let xyz = (0..24 * 12).flat_map(|index| {
        let (u, v) = ((index % 24) as f32 * 1e-3, (index / 24) as f32 * 1e-3);
        let z = 300.0 + 100.0 * u;
        [u * z, v * z, z].into_iter().flat_map(f32::to_le_bytes)
    });
    let range = (0..20u16 * 20).flat_map(|index| (1000 + index % 20).to_le_bytes());
    vec![
        std::iter::once(23 << 1).chain(xyz).collect(),
        std::iter::once(19 << 1 | 1).chain(range).collect(),
    ]
}

pub fn frame_seeds() -> Vec<Vec<u8>> {
    let kinds = [ComponentKind::Xyz, ComponentKind::Intensity, ComponentKind::Mask];
    let xyz: Vec<u8> = [1.0f32, 2.0, 300.0]
        .repeat(2)
        .into_iter()
        .flat_map(f32::to_le_bytes)
        .collect();
    let parts = [xyz, vec![7; 2], vec![0; 2]];
    let begin = FrameBegin {
        frame_id: 1,
        trigger_id: TriggerId(0),
        view_id: 0,
        config_id: 1,
        exposure_begin_ns: 1,
        exposure_end_ns: 2,
        reconstruction_end_ns: 3,
        flags: FrameFlags {
            pass_count: 1,
            binned: true,
            degraded: false,
            warm_up_incomplete: false,
            simulated: true,
        },
        width_px: 2,
        height_px: 1,
        camera_1_px: [0; 2],
        camera_2_px: [0; 2],
        calibration_id: 1,
        scale: [1.0; 3],
        offset: [0.0; 3],
        valid_count: 2,
        saturated_count: 0,
        temperature_c: [None; 4],
        components: kinds
            .iter()
            .zip(&parts)
            .map(|(&kind, part)| Component {
                kind,
                chunk_count: 1,
                byte_count: part.len() as u64,
            })
            .collect(),
    };
    let end = FrameEnd {
        frame_id: 1,
        trigger_id: TriggerId(0),
        status: FrameStatus::Complete,
        valid_count: 2,
        components: parts
            .iter()
            .map(|part| ComponentEnd {
                byte_count: part.len() as u64,
                crc: crc32c(part),
            })
            .collect(),
    };
    let mut messages = vec![ServerMessage::FrameBegin(Box::new(begin))];
    messages.extend((0u16..).zip(&parts).map(|(component_index, part)| {
        ServerMessage::FrameChunk(FrameChunk {
            frame_id: 1,
            component_index,
            chunk_index: 0,
            offset_bytes: 0,
            data: part,
        })
    }));
    messages.push(ServerMessage::FrameEnd(end));
    let mut writer = FrameWriter::default();
    let stream: Vec<Vec<u8>> = messages
        .iter()
        .map(|message| writer.write_with(message.kind(), 0, 0, |payload| message.encode(payload)))
        .collect();
    // Every type number with an empty payload, too: most are refused, and few are far from a message.
    let mut seeds = vec![stream.concat()];
    seeds.extend((0..0x80).map(|kind| FrameWriter::default().write_with(kind, 1, 0, |_| {})));
    seeds
}

/// Makes lengths, numbers and sums of the headers true again, frame by frame.
pub fn mend_frames(bytes: &mut [u8]) {
    let mut writer = FrameWriter::default();
    let mut at = 0;
    while bytes.len() - at >= HEADER_BYTES {
        let header = &bytes[at..at + HEADER_BYTES];
        let number =
            |place: usize| u32::from_le_bytes([header[place], header[place + 1], header[place + 2], header[place + 3]]);
        let payload_len = (number(8) as usize).min(bytes.len() - at - HEADER_BYTES);
        let end = at + HEADER_BYTES + payload_len;
        let whole = writer.write(&WireFrame {
            kind: number(6) as u16,
            request_id: number(12),
            flags: number(20) as u16 & 7,
            payload: &bytes[at + HEADER_BYTES..end],
        });
        bytes[at..end].copy_from_slice(&whole);
        at = end;
    }
}

/// The CRC-32C that a frame of these bytes states, read from its header.
fn crc32c(bytes: &[u8]) -> u32 {
    let frame = FrameWriter::default().write_with(0, 0, 0, |payload| payload.extend_from_slice(bytes));
    u32::from_le_bytes([frame[24], frame[25], frame[26], frame[27]])
}

/// What a frame may hold here.
const FRAME_BYTES_MAX: u64 = 1 << 16;
