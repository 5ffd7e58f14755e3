//! Getting the arm ready: one thing at a time is put right, then the status is read anew.

use super::{Arm, ArmEvent, State};
use crate::fault::FaultCode;
use crate::robot::{Command, ExecutingJob, Status};
use crate::stamp::Stamp;

/// Things put right one after the other until the arm takes moves.
#[derive(Debug, Clone, Copy)]
pub(super) struct Readying {
    since: Stamp,
    act_count: u32,
    /// Servo power has been asked for and may need time.
    pub(super) servo_asked: bool,
    /// The last act that was said got no answer.
    pub(super) is_unanswered: bool,
}

impl Readying {
    pub(super) fn begun(now: Stamp) -> Self {
        Self {
            since: now,
            act_count: 0,
            servo_asked: false,
            is_unanswered: false,
        }
    }
}

impl Arm {
    pub(super) fn decide_readying(&mut self, now: Stamp, status: Status, readying: Readying) {
        let late =
            now.ms_since(readying.since) >= self.settings.servo_timeout_ms || readying.act_count >= READYING_ACTS_MAX;
        let act = if status.alarm() || status.error() {
            return self.read_alarm(now);
        } else if !status.remote() {
            return self.fault(FaultCode::RobotNotRemote, "play mode with command remote is not set");
        } else if status.held_elsewhere() {
            // Only a person there can release it: hold here as well until then.
            return self.events.push_back(ArmEvent::HeldElsewhere);
        } else if status.held_by_command() {
            Some(Command::HoldOff)
        } else if status.running() {
            None
        } else if !status.servo_on() {
            Some(Command::ServoOn)
        } else {
            self.state = State::Locating;
            return self.exchange.say(now, Command::Position);
        };
        if late {
            let (code, seen) = match act {
                None => (FaultCode::RobotServo, "the arm does not come to rest".to_owned()),
                Some(act) if readying.is_unanswered => {
                    (FaultCode::RobotSilent, format!("{}: never answered", act.name()))
                }
                Some(act) => (FaultCode::RobotServo, format!("{} has no effect", act.name())),
            };
            return self.fault(code, seen);
        }
        match act {
            // A servo that is on its way needs time, not another switch-on.
            Some(Command::ServoOn) if readying.servo_asked => self.poll_later(now),
            Some(act) => {
                self.state = State::Readying(Readying {
                    act_count: readying.act_count + 1,
                    is_unanswered: false,
                    ..readying
                });
                // Ours from the asking on: the answer may get lost.
                self.servo_is_ours |= act == Command::ServoOn;
                self.exchange.say(now, act);
            }
            // The scan job of a run that was cut off still waits for orders; any other job is not ours to end.
            None if self.orders.is_some() => self.exchange.say(now, Command::ExecutingJob),
            None => self.poll_later(now),
        }
    }

    /// Which job runs while the arm is to be made ready.
    pub(super) fn decide_about_running(&mut self, now: Stamp, running: &ExecutingJob) {
        let Some(orders) = &self.orders else { return };
        if orders.is_of(&running.name) {
            let end_of_job = orders.order_to_end();
            self.exchange.say(now, end_of_job);
        } else {
            let seen = format!("the job {} is running on the controller: end it there", running.name);
            self.fault(FaultCode::RobotJob, seen);
        }
    }
}

const READYING_ACTS_MAX: u32 = 5;
