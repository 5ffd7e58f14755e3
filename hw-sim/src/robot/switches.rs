//! What a client switches: holds, servo power, resets, cycle, mode, the text on the pendant.

use crate::checks::refuse_first;
use crate::robot::alarms::CODE_ESTOP;
use crate::robot::controller::Controller;
use crate::robot::refused::{Answer, Refused};

/// How much of a job one start runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cycle {
    /// One instruction.
    Step,
    /// To the end of the job.
    Once,
    /// Again and again.
    Auto,
}

/// Mode of the pendant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// A person moves the arm.
    Teach,
    /// Jobs and orders move it.
    Play,
}

impl Controller {
    /// Switches the hold by command. On works in any mode and, unless an option says otherwise, without command remote.
    pub fn set_hold(&mut self, now_ns: u64, is_on: bool) -> Answer<()> {
        self.advance(now_ns);
        if !is_on || self.settings.options.hold_needs_remote {
            self.check_remote()?;
        }
        self.holds.command = is_on;
        if is_on {
            self.pause(now_ns);
        }
        Ok(())
    }

    /// Switches servo power. Off is immediate: the brakes fall.
    pub fn set_servo(&mut self, now_ns: u64, is_on: bool) -> Answer<()> {
        self.advance(now_ns);
        self.check_remote()?;
        if !is_on {
            self.servo_off(now_ns);
            return Ok(());
        }
        refuse_first([
            (!self.switches.is_playing, Refused::WRONG_MODE),
            (self.is_servo_barred(), Refused::SERVO_REFUSED),
            (self.alarms.is_any() || self.has_error, Refused::ALARM_PRESENT),
        ])?;
        self.switches.is_servo_on = true;
        self.last_active_ns = now_ns;
        Ok(())
    }

    /// Locks or frees the pendant's keys; nothing else depends on it.
    pub fn set_pendant_lock(&mut self, now_ns: u64, is_on: bool) -> Answer<()> {
        self.advance(now_ns);
        self.check_remote()?;
        self.switches.is_pendant_locked = is_on;
        Ok(())
    }

    /// Resets the alarms that can be reset from afar: no major one, none whose cause is still there.
    pub fn reset_alarms(&mut self, now_ns: u64) -> Answer<()> {
        self.advance(now_ns);
        self.check_remote()?;
        let is_pressed = self.switches.is_estop_pressed;
        self.alarms.reset(if is_pressed { &[CODE_ESTOP] } else { &[] });
        Ok(())
    }

    /// Cancels the error.
    pub fn cancel_error(&mut self, now_ns: u64) -> Answer<()> {
        self.advance(now_ns);
        self.check_remote()?;
        self.has_error = false;
        Ok(())
    }

    /// Sets how much of a job one start runs.
    pub fn set_cycle(&mut self, now_ns: u64, cycle: Cycle) -> Answer<()> {
        self.advance(now_ns);
        self.check_remote()?;
        self.switches.cycle = cycle;
        Ok(())
    }

    /// Turns to play or to teach; not while anything runs. No source says what a DX200 does with the key at REMOTE; here
    /// it obeys.
    pub fn set_mode(&mut self, now_ns: u64, mode: Mode) -> Answer<()> {
        self.advance(now_ns);
        self.check_remote()?;
        refuse_first([(self.is_running(), Refused::MOVING)])?;
        self.turn_mode(now_ns, mode);
        Ok(())
    }

    /// Shows a text on the pendant, at most 30 bytes; in any mode.
    pub fn show_text(&mut self, now_ns: u64, text: &[u8]) -> Answer<()> {
        self.advance(now_ns);
        refuse_first([(text.len() > TEXT_BYTES_MAX, Refused::OPERAND_LENGTH)])?;
        self.pendant_text = text.to_vec();
        Ok(())
    }

    /// What the pendant shows.
    pub fn pendant_text(&self) -> &[u8] {
        &self.pendant_text
    }

    /// A change of the mode stops what runs.
    pub(super) fn turn_mode(&mut self, now_ns: u64, mode: Mode) {
        let is_playing = mode == Mode::Play;
        if is_playing != self.switches.is_playing {
            self.pause(now_ns);
        }
        self.switches.is_playing = is_playing;
    }

    pub(super) fn is_servo_barred(&self) -> bool {
        self.switches.is_estop_pressed || self.switches.is_door_open || !self.switches.is_powered
    }

    pub(super) fn check_remote(&self) -> Answer<()> {
        refuse_first([(!self.switches.is_command_remote(), Refused::NOT_REMOTE)])
    }
}

/// Longest text on the pendant.
pub const TEXT_BYTES_MAX: usize = 30;
