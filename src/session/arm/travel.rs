//! Sending the arm to a pose and following it there.

use super::job::Counters;
use super::{Arm, ArmEvent, IDLE_POLL_MS, State};
use crate::fault::FaultCode;
use crate::robot::{Command, Move, Path, Position, Speed, Status, WirePose};
use crate::stamp::Stamp;
use nalgebra::Isometry3;

/// On the way to a pose.
#[derive(Debug)]
pub(super) struct Travel {
    /// Where it was read to stand before.
    departure: Isometry3<f64>,
    target: Isometry3<f64>,
    said: Said,
    pub(super) accepted_at: Stamp,
    begun_at: Stamp,
    /// The controller has neither accepted nor refused the move for good.
    pub(super) uncertain: bool,
    seen_running: bool,
    still_count: u32,
    attempt_count: u32,
    /// Where it was read to stand last, away from the target.
    read_at: Option<Isometry3<f64>>,
}

/// What has sent the arm on its way.
#[derive(Debug, Clone, Copy)]
enum Said {
    Move(Move),
    /// The order of this number.
    Order(i32),
}

impl Arm {
    /// Starts a straight way to the target of this index. Only while the arm stands ready.
    pub fn move_to(&mut self, now: Stamp, target_index: usize) {
        let target = self.targets[target_index];
        let from = self.last_pose.unwrap_or(target);
        let speed = self.speed(&from, &target);
        let (said, command) = match &mut self.orders {
            None => {
                let said = Move {
                    base_from_tool: WirePose::from_isometry(&target),
                    path: Path::Straight,
                    speed,
                    tool: self.settings.tool,
                };
                (Said::Move(said), Command::Move(said))
            }
            Some(orders) => {
                let (number, command) = orders.next(now, target_index, speed);
                (Said::Order(number), command)
            }
        };
        self.state = State::Travelling(Travel {
            departure: from,
            target,
            said,
            accepted_at: now,
            begun_at: now,
            uncertain: false,
            seen_running: false,
            still_count: 0,
            attempt_count: 1,
            read_at: None,
        });
        self.timer = None;
        self.exchange.say(now, command);
    }

    /// The status has been read on the way, and all is well.
    pub(super) fn follow(&mut self, now: Stamp, status: Status) {
        let State::Travelling(travel) = &mut self.state else {
            return;
        };
        travel.seen_running |= status.running();
        travel.still_count = if status.running() { 0 } else { travel.still_count + 1 };
        let stands = travel.still_count >= STILL_COUNT;
        match (travel.said, &self.orders) {
            (Said::Order(_), Some(orders)) => {
                let look = orders.look(stands);
                self.exchange.say(now, look);
            }
            _ if stands => self.exchange.say(now, Command::Position),
            _ => self.wait_on(now),
        }
    }

    /// What the scan job says on the way.
    pub(super) fn follow_job(&mut self, now: Stamp, counters: Counters) {
        let (State::Travelling(travel), Some(orders)) = (&self.state, &mut self.orders) else {
            return;
        };
        let Said::Order(number) = travel.said else { return };
        if counters.done == number {
            return self.exchange.say(now, Command::Position);
        }
        if travel.still_count >= STILL_COUNT && counters.is_whole() {
            let seen = format!("the scan job stopped before the pose was reached: {}", counters.words());
            return self.fault(FaultCode::RobotJob, seen);
        }
        let command = orders.said_again(now).unwrap_or_else(|| orders.beat());
        if self.in_time(now) {
            self.exchange.say(now, command);
        }
    }

    fn wait_on(&mut self, now: Stamp) {
        if self.in_time(now) {
            self.poll_later(now);
        }
    }

    /// Whether the move may take longer; otherwise its lateness has been reported.
    fn in_time(&mut self, now: Stamp) -> bool {
        let State::Travelling(travel) = &self.state else {
            return false;
        };
        let in_time = now.ms_since(travel.begun_at) < self.settings.move_timeout_ms;
        if !in_time {
            let seen = format!("the move has not ended after {} ms", self.settings.move_timeout_ms);
            self.fault(FaultCode::RobotLate, seen);
        }
        in_time
    }

    pub(super) fn handle_position(&mut self, now: Stamp, position: &Position) {
        let base_from_tool = position.base_from_tool.to_isometry();
        match &self.state {
            State::Locating => {
                self.last_pose = Some(base_from_tool);
                match &self.orders {
                    Some(_) => self.load(now, position.form),
                    None => self.stand_ready(now),
                }
            }
            State::Travelling(_) => self.decide_arrival(now, position, &base_from_tool),
            _ => {}
        }
    }

    pub(super) fn stand_ready(&mut self, now: Stamp) {
        self.state = State::Standing;
        self.timer = Some(now.plus_ms(IDLE_POLL_MS));
        self.events.push_back(ArmEvent::Ready);
    }

    /// The arm stands: where it was sent?
    fn decide_arrival(&mut self, now: Stamp, position: &Position, base_from_tool: &Isometry3<f64>) {
        let settings = &self.settings;
        let State::Travelling(travel) = &mut self.state else {
            return;
        };
        let (away_mm, away_rad) = super::ArmSettings::away(base_from_tool, &travel.target);
        // A position given for another tool says nothing about ours; it is normal before the first move.
        let right_tool = position.tool == i32::from(settings.tool);
        let near = settings.is_near(base_from_tool, &travel.target);
        let stayed = settings.is_near(base_from_tool, &travel.departure);
        self.last_pose = Some(*base_from_tool);
        if right_tool && near {
            self.state = State::Settling;
            self.timer = Some(now.plus_ms(settings.settle_ms));
            return;
        }
        if let Said::Move(said) = travel.said {
            if !travel.seen_running && now.ms_since(travel.accepted_at) < settings.start_grace_ms {
                travel.still_count = 0;
                return self.poll_later(now);
            }
            if travel.uncertain && stayed && travel.attempt_count < MOVE_ATTEMPTS_MAX {
                // It stands where it stood before: the move was never begun. The pose is absolute, so saying it anew
                // cannot take the arm anywhere else. An arm that stands on the way was stopped by somebody, and does
                // not go on by itself.
                travel.attempt_count += 1;
                travel.uncertain = false;
                travel.read_at = None;
                travel.still_count = 0;
                travel.accepted_at = now;
                return self.exchange.say(now, Command::Move(said));
            }
        }
        // The statuses before may have been late: what stands reads the same twice.
        let read_before = travel.read_at.replace(*base_from_tool);
        if !read_before.is_some_and(|before| settings.is_near(base_from_tool, &before)) {
            travel.still_count = 0;
            return self.wait_on(now);
        }
        let seen = if right_tool {
            let away_deg = away_rad.to_degrees();
            format!("it stands {away_mm:.3} mm and {away_deg:.4}° from the target")
        } else {
            let (found, wanted) = (position.tool, settings.tool);
            format!("the position is given for tool {found} instead of {wanted}")
        };
        self.fault(FaultCode::RobotElsewhere, seen);
    }

    /// Class VR when the turn takes longer than the way, else class V; at least one unit.
    fn speed(&self, from: &Isometry3<f64>, to: &Isometry3<f64>) -> Speed {
        let way_s = (to.translation.vector - from.translation.vector).norm() / self.settings.speed_mm_s;
        let turn_s = from.rotation.angle_to(&to.rotation) / self.settings.rotation_speed_rad_s;
        if turn_s > way_s {
            self.settings.turn_speed()
        } else {
            self.settings.tool_point_speed()
        }
    }
}

impl super::ArmSettings {
    /// Distance in mm and angle in rad between two poses.
    fn away(pose: &Isometry3<f64>, from: &Isometry3<f64>) -> (f64, f64) {
        let way = pose.translation.vector - from.translation.vector;
        (way.norm(), pose.rotation.angle_to(&from.rotation))
    }

    fn is_near(&self, pose: &Isometry3<f64>, to: &Isometry3<f64>) -> bool {
        let (away_mm, away_rad) = Self::away(pose, to);
        away_mm <= self.position_tolerance_mm && away_rad <= self.rotation_tolerance_rad
    }

    pub(super) fn tool_point_speed(&self) -> Speed {
        Speed::ToolPoint(tenths(self.speed_mm_s))
    }

    pub(super) fn turn_speed(&self) -> Speed {
        Speed::Turn(tenths(self.rotation_speed_rad_s.to_degrees()))
    }
}

pub(super) fn tenths(value: f64) -> u32 {
    (value * 10.0).round().max(1.0) as u32
}

const STILL_COUNT: u32 = 2;
const MOVE_ATTEMPTS_MAX: u32 = 3;
