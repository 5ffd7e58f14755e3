//! What the bridge keeps of a run: trigger ids that ended, and the last frames.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::camera::transfer::Picture;

/// Memory of one run.
#[derive(Clone, Debug, Default)]
pub(super) struct Store {
    /// Trigger ids that ended, oldest first.
    ended: VecDeque<u64>,
    /// Complete frames, oldest first.
    frames: VecDeque<Arc<Picture>>,
}

impl Store {
    /// An acquisition ended, with its frame or without.
    pub(super) fn end(&mut self, trigger_id: u64, frame: Option<Arc<Picture>>) {
        if self.ended.len() == ENDED_COUNT_MAX {
            self.ended.pop_front();
        }
        self.ended.push_back(trigger_id);
        if let Some(frame) = frame {
            if self.frames.len() == FRAME_COUNT_MAX {
                self.frames.pop_front();
            }
            self.frames.push_back(frame);
        }
    }

    /// Whether an acquisition of this id ended.
    pub(super) fn has_ended(&self, trigger_id: u64) -> bool {
        self.ended.contains(&trigger_id)
    }

    /// Frame of a trigger.
    pub(super) fn frame(&self, trigger_id: u64) -> Option<&Arc<Picture>> {
        self.frames.iter().find(|frame| frame.trigger_id() == trigger_id)
    }

    /// The last frame.
    pub(super) fn last(&self) -> Option<&Arc<Picture>> {
        self.frames.back()
    }
}

/// Ids that a repeated trigger is compared with.
const ENDED_COUNT_MAX: usize = 4096;
const FRAME_COUNT_MAX: usize = 4;
