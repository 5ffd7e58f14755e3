//! What came of one accepted trigger, step by step.

use super::Miss;
use super::bench::require;
use crate::camera::lines::{Heard, LineError, LineId, Lines, server_message};
use crate::camera::message::{
    Aborted, CameraError, DeviceEvent, ExposureDone, FrameBegin, FrameEnd, FrameStatus, ServerMessage, TRIGGER_ALL,
    TriggerId,
};
use crate::stamp::Stamp;

/// What came of one trigger.
#[derive(Debug, Default)]
pub(super) struct Course {
    pub(super) exposure_done: Vec<(Stamp, ExposureDone)>,
    pub(super) begin: Option<FrameBegin>,
    /// Bytes of each component that came so far.
    pub(super) components: Vec<Vec<u8>>,
    /// Chunks of each component that came so far.
    pub(super) chunk_counts: Vec<u32>,
    pub(super) ends: Vec<(Stamp, FrameEnd)>,
    pub(super) error: Option<CameraError>,
    pub(super) aborted: Option<Aborted>,
    /// Everything that came of it, header fields and payloads, in order, but for the data of chunks.
    pub(super) steps: Vec<&'static str>,
    begin_payload: Vec<u8>,
    end_payload: Vec<u8>,
}

impl Course {
    /// Takes frames of a connection until the acquisition has ended. Replies to requests stay where they are.
    pub(super) fn follow(lines: &mut Lines<'_>, line: LineId, id: TriggerId, ms: u64) -> Result<Self, Miss> {
        let mut course = Self::default();
        course.go_on(lines, line, id, ms)?;
        Ok(course)
    }

    /// The same, where a part of it was taken before.
    pub(super) fn go_on(&mut self, lines: &mut Lines<'_>, line: LineId, id: TriggerId, ms: u64) -> Result<(), Miss> {
        while !self.has_ended() {
            self.step(lines, line, id, ms)?;
        }
        Ok(())
    }

    /// Takes the next frame that belongs to the acquisition.
    pub(super) fn step(&mut self, lines: &mut Lines<'_>, line: LineId, id: TriggerId, ms: u64) -> Result<(), Miss> {
        let what = format!("end of trigger {:#x}: so far {}", id.0, self.words());
        let known_ms = pause_ms(lines, line, id);
        let mut heard = lines.hear_if(line, &what, ms, |heard| belongs(heard, id));
        // A pause that was announced meanwhile prolongs what was waited for.
        let paused_ms = pause_ms(lines, line, id) - known_ms;
        if matches!(heard, Err(LineError::Silent { .. })) && paused_ms > 0 {
            heard = lines.hear_if(line, &what, paused_ms, |heard| belongs(heard, id));
        }
        let heard = heard?;
        self.take(&heard, id)
    }

    pub(super) fn has_ended(&self) -> bool {
        let complete = self.ends.iter().any(|(_, end)| end.status == FrameStatus::Complete);
        let given_up = self.error.is_some() || self.aborted.is_some();
        complete || given_up && (self.begin.is_none() || !self.ends.is_empty())
    }

    /// Fails unless it ended with one complete frame.
    pub(super) fn is_complete(&self) -> Result<(), Miss> {
        if let Some(error) = &self.error {
            return Err(Miss::failed(format!("ERROR {} ended it: {}", error.code, error.text)));
        }
        let complete = self.ends.iter().any(|(_, end)| end.status == FrameStatus::Complete);
        require(complete, || format!("no complete frame came: {}", self.words()))
    }

    /// The steps, for people.
    pub(super) fn words(&self) -> String {
        match self.steps.as_slice() {
            [] => "nothing".into(),
            steps => steps.join(", "),
        }
    }

    /// Fails unless the two frames are the same in every byte.
    pub(super) fn is_same_frame_as(&self, other: &Self) -> Result<(), Miss> {
        require(self.begin_payload == other.begin_payload, || {
            "FRAME_BEGIN differs from that of the first time".into()
        })?;
        require(self.components == other.components, || {
            "the data differ from those of the first time".into()
        })?;
        require(self.end_payload == other.end_payload, || {
            "FRAME_END differs from that of the first time".into()
        })
    }

    fn take(&mut self, heard: &Heard, id: TriggerId) -> Result<(), Miss> {
        match server_message(heard)? {
            ServerMessage::ExposureDone(done) => {
                self.steps.push("EXPOSURE_DONE");
                require(done.trigger_id == id, || format!("of another trigger: {heard}"))?;
                self.exposure_done.push((heard.at, done));
            }
            ServerMessage::FrameBegin(begin) => {
                self.steps.push("FRAME_BEGIN");
                require(begin.trigger_id == id, || format!("of another trigger: {heard}"))?;
                require(self.begin.is_none(), || format!("a second frame: {heard}"))?;
                self.components = begin.components.iter().map(|_| Vec::new()).collect();
                self.chunk_counts = vec![0; begin.components.len()];
                self.begin_payload.clone_from(&heard.payload);
                self.begin = Some(*begin);
            }
            ServerMessage::FrameChunk(chunk) => {
                if self.steps.last() != Some(&"FRAME_CHUNK ...") {
                    self.steps.push("FRAME_CHUNK ...");
                }
                let Some(begin) = &self.begin else {
                    return Err(Miss::failed(format!("a chunk before FRAME_BEGIN: {heard}")));
                };
                require(chunk.frame_id == begin.frame_id, || {
                    format!("of another frame: {heard}")
                })?;
                let index = usize::from(chunk.component_index);
                let current = self.current();
                require(index == current, || {
                    format!("component {current} is to go on, this is of {index}: {heard}")
                })?;
                let (bytes, count) = (&mut self.components[index], &mut self.chunk_counts[index]);
                require(chunk.chunk_index == *count, || {
                    format!("chunk {count} is next: {heard}")
                })?;
                require(chunk.offset_bytes == bytes.len() as u64, || {
                    format!("offset {} is next: {heard}", bytes.len())
                })?;
                bytes.extend_from_slice(chunk.data);
                *count += 1;
                let most = begin.components[index].byte_count;
                require(bytes.len() as u64 <= most, || {
                    format!("component {index} has {most} bytes by FRAME_BEGIN, more came: {heard}")
                })?;
            }
            ServerMessage::FrameEnd(end) => {
                self.steps.push(match end.status {
                    FrameStatus::Complete => "FRAME_END 0",
                    FrameStatus::Aborted => "FRAME_END 1",
                    FrameStatus::Failed => "FRAME_END 2",
                });
                require(end.trigger_id == id, || format!("of another trigger: {heard}"))?;
                self.end_payload.clone_from(&heard.payload);
                self.ends.push((heard.at, end));
            }
            ServerMessage::Error(error) => {
                self.steps.push("ERROR");
                self.error = Some(error);
            }
            ServerMessage::Aborted(aborted) => {
                self.steps.push("ABORTED");
                self.aborted = Some(aborted);
            }
            _ => return Err(Miss::failed(format!("not of an acquisition: {heard}"))),
        }
        Ok(())
    }

    /// The component whose bytes are to come.
    fn current(&self) -> usize {
        let components = self.begin.iter().flat_map(|begin| &begin.components);
        let is_whole = |(component, bytes): &(&crate::camera::message::Component, &Vec<u8>)| {
            bytes.len() as u64 >= component.byte_count
        };
        components.zip(&self.components).take_while(is_whole).count()
    }
}

/// How long the pauses last that were announced for a trigger or for none; 60 s at most (section 3.7 of the page).
pub(super) fn pause_ms(lines: &Lines<'_>, line: LineId, id: TriggerId) -> u64 {
    let events = lines.line(line).events().iter();
    let pauses = events
        .filter(|event| event.code == DeviceEvent::COOLDOWN_PAUSE && [id.0, TRIGGER_ALL].contains(&event.trigger_id));
    let sum_ms: u64 = pauses.map(|event| u64::from(event.duration_ms)).sum();
    sum_ms.min(60_000)
}

/// Whether a frame belongs to an acquisition. Frames of other acquisitions are taken too: they are wrong here.
fn belongs(heard: &Heard, id: TriggerId) -> bool {
    match heard.kind {
        0x22 | 0x30..=0x32 => true,
        0x41 => true,
        0x70 => match server_message(heard) {
            Ok(ServerMessage::Error(error)) => !heard.is_reply() && [id.0, TRIGGER_ALL].contains(&error.trigger_id),
            _ => true,
        },
        _ => false,
    }
}
