//! What happens as time passes: phases of the acquisition, chunks, and the incidents among them.

use std::sync::Arc;

use super::{Bridge, Condition, Refusal, Sending, Step};
use crate::camera::a3dp::Damage;
use crate::camera::acquisition::{FLAG_DEGRADED, Stage};
use crate::camera::device::DeviceSettings;
use crate::camera::identity::LINK_MBIT_S;
use crate::camera::message::Message;
use crate::camera::script::{Mark, is_incident};
use crate::camera::transfer::{self, Picture, Transfer};
use crate::camera::trouble::{Phase, Trouble};

impl Bridge {
    pub(super) fn acquisition_due_ns(&self) -> Option<u64> {
        let acquisition = self.acquisition.as_ref()?;
        let due_ns = acquisition.due_ns(&self.script)?;
        match (&self.sending, acquisition.stage) {
            // Frames are never interleaved.
            (Some(_), Stage::Reconstructing) if due_ns >= acquisition.reconstruction_end_ns => None,
            _ => Some(due_ns),
        }
    }

    pub(super) fn take_what_is_due(&mut self, now_ns: u64, device: &DeviceSettings) {
        let is_due = |due_ns: &u64| *due_ns <= now_ns;
        if let Condition::Away { back_ns, .. } = self.condition
            && is_due(&back_ns)
        {
            return self.come_back(now_ns);
        }
        let sending_ns = self.sending.as_ref().map(|sending| sending.next_ns).filter(is_due);
        let is_own = self.sending.as_ref().is_some_and(|sending| sending.is_own);
        let acquisition_ns = self.acquisition_due_ns().filter(is_due);
        let own_ns = if is_own { sending_ns } else { acquisition_ns };
        let deadline_ns = self.acquisition.as_ref().and_then(|flying| flying.deadline_ns);
        if deadline_ns.is_some_and(|deadline_ns| deadline_ns <= own_ns.unwrap_or(now_ns)) {
            return self.give_up(407, 0, "the deadline has passed");
        }
        if acquisition_ns.is_some() {
            self.pass_stage(now_ns);
        } else if sending_ns.is_some() {
            self.send_chunk(now_ns, device);
        }
    }

    /// The middle or the end of the acquisition's stage is reached.
    fn pass_stage(&mut self, now_ns: u64) {
        let Some(acquisition) = &mut self.acquisition else {
            return;
        };
        let trigger_id = acquisition.trigger_id;
        let (phase, page_phase) = match acquisition.stage {
            Stage::Exposing => (Phase::Exposure, acquisition.phase()),
            _ => (Phase::Reconstruction, acquisition.phase()),
        };
        if let Some(trouble) = self.script.meet(trigger_id, phase, is_incident) {
            return self.strike(now_ns, trouble, trigger_id, page_phase);
        }
        if acquisition.stage != Stage::Exposing {
            return self.begin_frame(now_ns);
        }
        if acquisition.pause_us > 0 {
            let pause_us = core::mem::take(&mut acquisition.pause_us);
            return self.pause(now_ns, f64::from(pause_us) * 1e-6);
        }
        acquisition.stage = Stage::Reconstructing;
        let job = acquisition.job;
        self.tell_exposure_done();
        self.steps.push_back(Step::Exposed(job));
    }

    /// EXPOSURE_DONE to whoever waits for it.
    pub(super) fn tell_exposure_done(&mut self) {
        let Some(acquisition) = &mut self.acquisition else {
            return;
        };
        let (trigger_id, message) = (acquisition.trigger_id, acquisition.exposure_done());
        acquisition.told = acquisition.receiver;
        let Some(to) = acquisition.receiver else { return };
        if self.meets(trigger_id, Phase::Exposure, |trouble| trouble == Trouble::NoExposure) {
            return;
        }
        let mark = self.script.mark(trigger_id, Phase::Exposure);
        let is_doubled = self.meets(trigger_id, Phase::Exposure, |trouble| {
            trouble == Trouble::DoubleExposure
        });
        if is_doubled {
            self.push_message(to, message.clone(), Mark::default());
        }
        self.push_message(to, message, mark);
    }

    fn begin_frame(&mut self, now_ns: u64) {
        let Some(acquisition) = &mut self.acquisition else {
            return;
        };
        let Some(mut frame) = acquisition.frame.take() else {
            return;
        };
        self.counts.frame_ids += 1;
        let trigger_id = acquisition.trigger_id;
        let mut head = acquisition.head(now_ns, self.counts.frame_ids, &self.thermal);
        let mut meets =
            |phase, is_wanted: fn(Trouble) -> bool| self.script.meet(trigger_id, phase, is_wanted).is_some();
        if meets(Phase::Reconstruction, |trouble| trouble == Trouble::Empty) {
            transfer::empty(&mut frame);
        }
        if meets(Phase::Reconstruction, |trouble| trouble == Trouble::Degraded) {
            head.frame_flags |= FLAG_DEGRADED;
            self.counts.since_start.lost_packets += LOST_PACKETS;
        }
        let mut picture = Picture::new(head, &acquisition.config.settings, frame);
        if meets(Phase::Reconstruction, |trouble| trouble == Trouble::WrongCount) {
            picture.miscount();
        }
        let picture = Arc::new(picture);
        let Some(to) = acquisition.receiver else {
            return self.finish(Some(picture));
        };
        let older = self.store.last().cloned();
        if let Some(older) = older
            && self.meets(trigger_id, Phase::Transfer, |trouble| trouble == Trouble::OlderFrame)
        {
            self.finish(Some(picture));
            return self.send_picture(now_ns, older, to, Mark::default(), false);
        }
        if let Some(acquisition) = &mut self.acquisition {
            acquisition.stage = Stage::Sending;
        }
        let mark = self.script.mark(trigger_id, Phase::Reconstruction);
        self.send_picture(now_ns, picture, to, mark, true);
    }

    /// A frame is sent from its beginning.
    pub(super) fn send_picture(&mut self, now_ns: u64, picture: Arc<Picture>, to: u64, mark: Mark, is_own: bool) {
        self.push_message(to, Message::FrameBegin(picture.begin().clone()), mark);
        self.sending = Some(Sending {
            transfer: Transfer::new(picture),
            to,
            next_ns: now_ns,
            is_own,
        });
    }

    fn send_chunk(&mut self, now_ns: u64, device: &DeviceSettings) {
        let Some(sending) = &mut self.sending else { return };
        let (to, trigger_id) = (sending.to, sending.transfer.picture().trigger_id());
        let mut mark = Mark::default();
        if sending.transfer.is_half_sent() {
            if let Some(trouble) = self.script.meet(trigger_id, Phase::Transfer, is_incident) {
                if trouble == Trouble::Gone
                    && let Some(chunk) = sending.transfer.poll_chunk()
                {
                    mark.damage = Some(Damage::Cut);
                    self.steps.push_back(Step::Chunk { to, chunk, mark });
                }
                return self.strike(now_ns, trouble, trigger_id, PHASE_TRANSFER);
            }
            mark = self.script.mark(trigger_id, Phase::Transfer);
            if self.meets(trigger_id, Phase::Transfer, |trouble| trouble == Trouble::EarlyEnd) {
                return self.end_frame(now_ns);
            }
        }
        let Some(sending) = &mut self.sending else { return };
        let Some(mut chunk) = sending.transfer.poll_chunk() else {
            return self.end_frame(now_ns);
        };
        let link_ns = chunk.data().len() as f64 * 8e3 / f64::from(LINK_MBIT_S);
        sending.next_ns += (link_ns / device.speed) as u64;
        if self.meets(trigger_id, Phase::Transfer, |trouble| {
            trouble == Trouble::CorruptComponent
        }) {
            chunk.damage();
        }
        self.steps.push_back(Step::Chunk { to, chunk, mark });
    }

    fn end_frame(&mut self, now_ns: u64) {
        let Some(sending) = self.sending.take() else { return };
        let (to, picture) = (sending.to, sending.transfer.picture().clone());
        let trigger_id = picture.trigger_id();
        let mut end = picture.end_complete();
        if self.meets(trigger_id, Phase::Transfer, |trouble| trouble == Trouble::WrongCount) {
            end.tail.valid_count += 1;
        }
        self.push_message(to, Message::FrameEnd(end), Mark::default());
        if sending.is_own {
            self.counts.since_start.frames += 1;
            self.finish(Some(picture.clone()));
        }
        if self.meets(trigger_id, Phase::Transfer, |trouble| trouble == Trouble::DoubleFrame) {
            self.send_picture(now_ns, picture, to, Mark::default(), false);
        }
    }

    /// Something happens to connections, bridge or device.
    pub(super) fn strike(&mut self, now_ns: u64, trouble: Trouble, trigger_id: u64, phase: u8) {
        match trouble {
            Trouble::Gone => self.steps.extend(self.controller.map(Step::HangUp)),
            Trouble::Silent => self.steps.extend(self.controller.map(Step::FallSilent)),
            Trouble::Restart => self.steps.push_back(Step::Restart),
            Trouble::Kicked => self.steps.push_back(Step::Kick),
            Trouble::Pause { span_s } => self.pause(now_ns, span_s),
            Trouble::Reset { .. } | Trouble::Lost { .. } | Trouble::Broken => self.leave(now_ns, trouble),
            _ => {
                let refusal = self.failure(now_ns, trouble, trigger_id, phase);
                self.end_with(refusal);
            }
        }
    }

    /// What ends an acquisition, or refuses its trigger, when this goes wrong with the device; its EVENT is due before.
    pub(super) fn failure(&mut self, now_ns: u64, trouble: Trouble, trigger_id: u64, phase: u8) -> Refusal {
        let counts = &mut self.counts.since_start;
        let (code, span_s, text) = match trouble {
            Trouble::Error { code } => (code, 0.0, "a fault of the simulation"),
            Trouble::Missed => {
                counts.missed += 1;
                self.push_event(now_ns, EVENT_MISSED_TRIGGER, trigger_id, 0.0, "trigger missed");
                (401, 0.0, "the trigger was missed")
            }
            Trouble::Hot { span_s } => {
                self.push_event(now_ns, EVENT_OVER_TEMPERATURE, trigger_id, span_s, "too hot");
                (502, span_s, "the device is too hot")
            }
            Trouble::VendorTimeout { span_s } => {
                counts.vendor_timeouts += 1;
                let code = if phase == PHASE_EXPOSURE { 402 } else { 403 };
                (code, span_s, "the vendor's SDK has timed out")
            }
            _ => (500, 0.0, "the device does not work"),
        };
        let until_ns = now_ns + (span_s * 1e9) as u64;
        match trouble {
            Trouble::Hot { .. } => self.refusing = Some((502, until_ns)),
            Trouble::VendorTimeout { .. } => self.refusing = Some((503, until_ns)),
            _ => (),
        }
        let is_hot = matches!(trouble, Trouble::Hot { .. });
        Refusal {
            trigger_id,
            phase,
            is_retryable: true,
            retry_after_ms: if is_hot { (span_s * 1e3).ceil() as u32 } else { 0 },
            vendor_code: if matches!(trouble, Trouble::VendorTimeout { .. }) {
                VENDOR_TIMEOUT
            } else {
                0
            },
            ..Refusal::new(code, text)
        }
    }

    /// Ends the acquisition with an ERROR that names it, and the frame if it had begun.
    pub(super) fn give_up(&mut self, code: u16, retry_after_ms: u32, text: &str) {
        let Some(acquisition) = &self.acquisition else { return };
        self.end_with(Refusal {
            trigger_id: acquisition.trigger_id,
            phase: acquisition.phase(),
            retry_after_ms,
            ..Refusal::new(code, text)
        });
    }

    /// Ends what the refusal names: the acquisition, or the sending of a stored frame.
    fn end_with(&mut self, refusal: Refusal) {
        let trigger_id = refusal.trigger_id;
        let sending = self
            .sending
            .take_if(|sending| sending.transfer.picture().trigger_id() == trigger_id);
        let mut to = sending.as_ref().map(|sending| sending.to);
        if let Some(acquisition) = self
            .acquisition
            .as_ref()
            .filter(|flying| flying.trigger_id == trigger_id)
        {
            to = acquisition.receiver;
            self.finish(None);
        }
        let Some(to) = to else { return };
        self.steps.push_back(Step::Error { to, refusal });
        if let Some(sending) = sending {
            self.push_message(to, Message::FrameEnd(sending.transfer.end_early(2)), Mark::default());
        }
    }

    fn pause(&mut self, now_ns: u64, span_s: f64) {
        let Some(acquisition) = &mut self.acquisition else {
            return;
        };
        acquisition.put_off((span_s * 1e9) as u64);
        let trigger_id = acquisition.trigger_id;
        self.push_event(now_ns, EVENT_COOL_DOWN, trigger_id, span_s, "LED pause");
    }

    fn meets(&mut self, trigger_id: u64, phase: Phase, is_wanted: fn(Trouble) -> bool) -> bool {
        self.script.meet(trigger_id, phase, is_wanted).is_some()
    }

    fn push_message(&mut self, to: u64, message: Message, mark: Mark) {
        self.steps.push_back(Step::Send {
            to,
            request_id: 0,
            message,
            mark,
        });
    }
}

const PHASE_EXPOSURE: u8 = 2;
const PHASE_TRANSFER: u8 = 4;
const EVENT_MISSED_TRIGGER: u16 = 1;
const EVENT_OVER_TEMPERATURE: u16 = 2;
const EVENT_COOL_DOWN: u16 = 5;
/// Packets that count as lost where a frame is degraded.
const LOST_PACKETS: u32 = 7;
/// The vendor's number of a time-out; no real one is known.
const VENDOR_TIMEOUT: i32 = -1;
