//! What a person does at the cell.

use crate::robot::alarms::CODE_ESTOP;
use crate::robot::controller::Controller;
use crate::robot::switches::Mode;

/// What a person at the cell does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Panel {
    /// Turns the mode to play, or to teach.
    Play(bool),
    /// Turns the key to remote, or away from it.
    Remote(bool),
    /// Switches the pseudo input CMD REMOTE SEL (#82015): on at first. Without it the key at remote is not enough.
    CommandRemoteSelect(bool),
    /// Presses or releases the hold of the pendant.
    Hold(bool),
    /// Presses or releases the hold of the operator's panel.
    PanelHold(bool),
    /// Switches the external hold signal.
    ExternalHold(bool),
    /// Presses or releases the emergency stop.
    EmergencyStop(bool),
    /// Opens or closes the cell's door. While it is open there is no servo power.
    Door(bool),
    /// Switches the speed restriction.
    SpeedRestriction(bool),
    /// Something raises an alarm of this code.
    Alarm(u32),
    /// Something raises an error, to be cancelled.
    Error,
    /// Resets alarms at the pendant: the same ones as from afar.
    Reset,
    /// Switches servo power at the pendant, in any mode and without command remote.
    Servo(bool),
    /// Switches the controller off, or on again. Off, it answers nothing; on again, servo power is off, nothing runs, no alarm is
    /// active and all memory is as it was.
    Power(bool),
    /// A wire at an input: the signal by its number, whose last digit is 0 to 7. Numbers that do not exist change nothing.
    Signal {
        /// For example 20010.
        signal: u32,
        /// State of the wire.
        is_on: bool,
    },
}

impl Controller {
    /// Takes what a person does at the cell.
    pub fn handle_panel(&mut self, now_ns: u64, panel: Panel) {
        self.advance(now_ns);
        match panel {
            Panel::Play(is_playing) => self.turn_mode(now_ns, if is_playing { Mode::Play } else { Mode::Teach }),
            Panel::Remote(is_remote) => self.switches.is_remote_key = is_remote,
            Panel::CommandRemoteSelect(is_on) => self.switches.is_remote_selected = is_on,
            Panel::Hold(is_held) => self.holds.pendant = is_held,
            Panel::PanelHold(is_held) => self.holds.panel = is_held,
            Panel::ExternalHold(is_held) => self.holds.external = is_held,
            Panel::EmergencyStop(true) => self.press_estop(now_ns),
            Panel::EmergencyStop(false) => self.switches.is_estop_pressed = false,
            Panel::Door(is_open) => {
                self.switches.is_door_open = is_open;
                if is_open {
                    self.servo_off(now_ns);
                }
            }
            Panel::SpeedRestriction(is_on) => self.switches.is_speed_restricted = is_on,
            Panel::Alarm(code) => self.raise_alarm(now_ns, code, 1),
            Panel::Error => {
                self.has_error = true;
                self.pause(now_ns);
            }
            Panel::Reset => {
                let is_pressed = self.switches.is_estop_pressed;
                self.alarms.reset(if is_pressed { &[CODE_ESTOP] } else { &[] });
            }
            Panel::Servo(true) => {
                self.switches.is_servo_on |= !self.is_servo_barred() && !self.alarms.is_any();
                self.last_active_ns = now_ns;
            }
            Panel::Servo(false) => self.servo_off(now_ns),
            Panel::Power(is_on) => self.switch_power(now_ns, is_on),
            Panel::Signal { signal, is_on } => {
                self.signals.set_signal(signal, is_on).ok();
            }
        }
        if self.holds.pendant || self.holds.panel || self.holds.external {
            self.pause(now_ns);
        }
    }

    pub(super) fn press_estop(&mut self, now_ns: u64) {
        self.switches.is_estop_pressed = true;
        self.servo_off(now_ns);
        if self.settings.options.estop_latches_alarm {
            self.raise_alarm(now_ns, CODE_ESTOP, 0);
        }
    }

    pub(super) fn switch_power(&mut self, now_ns: u64, is_on: bool) {
        self.servo_off(now_ns);
        self.switches.is_powered = is_on;
        self.incidents.clear();
        self.forget_transfer();
        self.holds.command = false;
        self.has_error = false;
        self.alarms.clear();
        if self.switches.is_estop_pressed && self.settings.options.estop_latches_alarm {
            self.raise_alarm(now_ns, CODE_ESTOP, 0);
        }
    }
}
