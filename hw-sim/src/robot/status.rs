//! What a client reads: status, alarms, the executing job, positions, times and the system's name.

use crate::robot::alarms::{ACTIVE_COUNT_MAX, Alarm, AlarmGroup, HISTORY_COUNT_MAX};
use crate::robot::axes::AXIS_COUNT;
use crate::robot::controller::Controller;
use crate::robot::moves::{COORDINATE_BASE, FORM};
use crate::robot::pose::Pose;
use crate::robot::refused::{Answer, Refused};
use crate::robot::switches::Cycle;
use crate::robot::variables::Position;

/// Who the controller says it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SystemInformation {
    /// Software, at most 24 bytes.
    pub software: &'static str,
    /// Model, at most 16 bytes.
    pub model: &'static str,
    /// Parameters, at most 8 bytes.
    pub parameters: &'static str,
}

/// How long something has been on, by the controller's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ManagementTime {
    /// Since when it counts, ns of the cell's clock.
    pub start_ns: u64,
    /// How long it was on, ns of the controller.
    pub elapsed_ns: u64,
}

impl Controller {
    /// The two words of the status. Word 1: bit 0 step, 1 one cycle, 2 auto, 3 running, 4 speed restricted, 5 teach, 6 play,
    /// 7 command remote. Word 2: bit 1 held by pendant, 2 externally, 3 by command, 4 alarm, 5 error, 6 servo on.
    pub fn status(&mut self, now_ns: u64) -> [u32; 2] {
        self.advance(now_ns);
        let bit = |is_set: bool, bit: u32| u32::from(is_set) << bit;
        let switches = &self.switches;
        let word_1 = bit(switches.cycle == Cycle::Step, 0)
            | bit(switches.cycle == Cycle::Once, 1)
            | bit(switches.cycle == Cycle::Auto, 2)
            | bit(self.is_running(), 3)
            | bit(switches.is_speed_restricted, 4)
            | bit(!switches.is_playing, 5)
            | bit(switches.is_playing, 6)
            | bit(switches.is_command_remote(), 7);
        // There is no bit for the panel's hold, though it has a refusal of its own: the external one stands for both.
        let word_2 = bit(self.holds.pendant, 1)
            | bit(self.holds.external || self.holds.panel, 2)
            | bit(self.holds.command, 3)
            | bit(self.alarms.is_any(), 4)
            | bit(self.has_error, 5)
            | bit(switches.is_servo_on, 6);
        [word_1, word_2]
    }

    /// Active alarm, 1 the newest to 4; A001 beyond.
    pub fn alarm(&mut self, now_ns: u64, number: u16) -> Answer<Option<Alarm>> {
        self.advance(now_ns);
        let index = index_of(number, ACTIVE_COUNT_MAX)?;
        Ok(self.alarms.active(index))
    }

    /// Alarm of a list of the history, 1 the newest to 100; A001 beyond.
    pub fn alarm_history(&mut self, now_ns: u64, group: AlarmGroup, number: u16) -> Answer<Option<Alarm>> {
        self.advance(now_ns);
        let index = index_of(number, HISTORY_COUNT_MAX)?;
        Ok(self.alarms.history(group, index))
    }

    /// The arm's position in pulses (type 0).
    pub fn position_pulses(&mut self, now_ns: u64) -> Position {
        self.advance(now_ns);
        self.standing_pulses(now_ns)
    }

    /// The arm's pose in the base (type 16). The robot's own frame is the same.
    pub fn position_base(&mut self, now_ns: u64) -> Position {
        self.advance(now_ns);
        self.standing_base(now_ns)
    }

    /// Following error of each axis in pulses: the simulated drives have none.
    pub fn position_error(&mut self, now_ns: u64) -> [i32; 8] {
        self.advance(now_ns);
        [0; 8]
    }

    /// Torque of each axis in percent: what holds the arm up while servo power is on, more while it moves.
    pub fn torque_percent(&mut self, now_ns: u64) -> [i32; 8] {
        self.advance(now_ns);
        match (self.switches.is_servo_on, self.motion.is_some()) {
            (false, _) => [0; 8],
            (true, false) => [0, 12, 8, 0, 3, 0, 0, 0],
            (true, true) => [6, 20, 14, 2, 5, 2, 0, 0],
        }
    }

    /// How long something has been on: 1 the controller, 10 and 11 servo power, 110 and 111 playback, 210 and 211 motion,
    /// 301 to 308 the applications, of which there are none; A001 for other numbers.
    pub fn management_time(&mut self, now_ns: u64, number: u16) -> Answer<ManagementTime> {
        self.advance(now_ns);
        let times = &self.times;
        let elapsed_ns = match number {
            1 => now_ns,
            10 | 11 => times.servo_ns,
            110 | 111 => times.playback_ns,
            210 | 211 => times.moving_ns,
            301..=308 => 0,
            _ => return Err(Refused::NO_INSTANCE),
        };
        Ok(ManagementTime {
            start_ns: 0,
            elapsed_ns: self.controller_ns(elapsed_ns),
        })
    }

    /// Who the controller says it is: a simulated one.
    pub fn system_information(&self) -> SystemInformation {
        SystemInformation {
            software: concat!("SIMULATED ", env!("CARGO_PKG_VERSION")),
            model: "SIMULATED DX200",
            parameters: "SIM",
        }
    }

    /// Where the arm is once everything due has happened.
    pub(super) fn standing(&self, now_ns: u64) -> Pose {
        self.motion.as_ref().map_or(self.pose, |motion| motion.pose(now_ns))
    }

    pub(super) fn standing_pulses(&self, now_ns: u64) -> Position {
        self.position(0, 0, self.standing(now_ns).to_pulses())
    }

    pub(super) fn standing_base(&self, now_ns: u64) -> Position {
        self.position(COORDINATE_BASE, FORM, self.standing(now_ns).to_pulses())
    }

    fn position(&self, kind: i32, form: i32, axes: [i32; AXIS_COUNT]) -> Position {
        let [a, b, c, d, e, f] = axes;
        Position {
            kind,
            form,
            tool: self.tool,
            user: 0,
            form_ext: 0,
            axes: [a, b, c, d, e, f, 0, 0],
        }
    }
}

fn index_of(number: u16, count: usize) -> Answer<usize> {
    let index = usize::from(number).checked_sub(1);
    index.filter(|index| *index < count).ok_or(Refused::NO_INSTANCE)
}
