//! Moves that a client orders: what they must look like, and what they do.

use nalgebra::Isometry3;

use crate::checks::refuse_first;
use crate::fault::Fault;
use crate::robot::controller::{Controller, Incident};
use crate::robot::motion::{Motion, Rate};
use crate::robot::pose::Pose;
use crate::robot::refused::{Answer, Refused};
use crate::robot::variables::TOOL_COUNT;

/// How the arm gets to its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Path {
    /// All axes together.
    Link,
    /// On a line.
    Straight,
}

/// Speed as the protocols write it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OrderedSpeed {
    /// 0 share of the fastest, 1 tool point (V), 2 turn (VR).
    pub class: i32,
    /// In 0.01 %, 0.1 mm/s or 0.1 deg/s.
    pub value: i32,
}

/// A move to a pose, or by one, as the protocols write it; nothing of it is checked yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CartesianOrder {
    /// Way to the target.
    pub path: Path,
    /// Whether the pose is added to that of the arm. A turn is about the axes of `coordinate`.
    pub is_increment: bool,
    /// Speed.
    pub speed: OrderedSpeed,
    /// 16 base, 17 robot, 18 user, 19 tool. The robot stands in its base, so that 16 and 17 are one.
    pub coordinate: i32,
    /// x, y, z in µm, Rx, Ry, Rz in 0.0001 degrees.
    pub pose: Pose,
    /// Form bits; without bit 7 they are ignored.
    pub form: i32,
    /// Extended form bits, likewise.
    pub form_ext: i32,
    /// Tool, 0 to 63.
    pub tool: i32,
    /// User coordinate; none is taught.
    pub user: i32,
}

/// A move to pulses, as the protocols write it; nothing of it is checked yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PulseOrder {
    /// Way to the target.
    pub path: Path,
    /// Speed.
    pub speed: OrderedSpeed,
    /// S, L, U, R, B, T and two axes that the arm does not have.
    pub pulses: [i32; 8],
    /// Tool, 0 to 63.
    pub tool: i32,
}

impl Controller {
    /// Moves to a pose or by one. Done once the move has begun.
    pub fn move_cartesian(&mut self, now_ns: u64, order: &CartesianOrder) -> Answer<()> {
        self.check_can_move(now_ns)?;
        let rate = order.speed.rate()?;
        let is_known = match order.coordinate {
            COORDINATE_BASE | COORDINATE_ROBOT => true,
            COORDINATE_TOOL => order.is_increment,
            _ => false,
        };
        let is_form_given = order.form & FORM_IS_GIVEN != 0;
        let is_form_right = (order.form, order.form_ext) == (FORM_IS_GIVEN | FORM, 0);
        let is_form = (0..=0xFF).contains(&order.form) && (!is_form_given || is_form_right);
        refuse_first([
            (!is_known, Refused::COORDINATE),
            (!is_form, Refused::FORM),
            (!(0..TOOL_COUNT).contains(&order.tool), Refused::TOOL),
            (order.user != 0, Refused::USER_FRAME),
        ])?;
        let target = if order.is_increment {
            self.incremented(order)?
        } else {
            order.pose
        };
        self.check_reach(&target)?;
        self.tool = order.tool;
        self.begin_move(now_ns, order.path, target, rate);
        Ok(())
    }

    /// Moves to pulses. Done once the move has begun.
    pub fn move_pulses(&mut self, now_ns: u64, order: &PulseOrder) -> Answer<()> {
        self.check_can_move(now_ns)?;
        let rate = order.speed.rate()?;
        let [s, l, u, r, b, t, others @ ..] = order.pulses;
        refuse_first([
            (!(0..TOOL_COUNT).contains(&order.tool), Refused::TOOL),
            (others != [0, 0], Refused::VALUE),
        ])?;
        let target = Pose::from_pulses([s, l, u, r, b, t]);
        self.check_reach(&target)?;
        self.tool = order.tool;
        self.begin_move(now_ns, order.path, target, rate);
        Ok(())
    }

    /// What stands against any move, in the order of the protocol page.
    pub fn check_can_move(&mut self, now_ns: u64) -> Answer<()> {
        self.advance(now_ns);
        self.check_remote()?;
        self.check_can_run()?;
        refuse_first([(self.is_running(), Refused::MOVING)])
    }

    /// Mode, alarms, holds and servo power, in this order.
    pub(super) fn check_can_run(&self) -> Answer<()> {
        refuse_first([
            (!self.switches.is_playing, Refused::WRONG_MODE),
            (self.alarms.is_any() || self.has_error, Refused::ALARM_PRESENT),
            (self.holds.pendant, Refused::HELD_BY_PENDANT),
            (self.holds.panel, Refused::HELD_BY_PANEL),
            (self.holds.external, Refused::HELD_EXTERNALLY),
            (self.holds.command, Refused::HELD_BY_COMMAND),
            (!self.switches.is_servo_on, Refused::SERVO_OFF),
        ])
    }

    /// B004 beyond workspace or axes: refused before the arm moves. A job meets an alarm instead.
    pub(super) fn check_reach(&self, target: &Pose) -> Answer<()> {
        let is_within = target.is_within(&self.settings.workspace_min_um, &self.settings.workspace_max_um);
        refuse_first([(!is_within, Refused::VALUE)])
    }

    /// Begins a move from where the arm stands. Faults that name this move happen in its middle.
    pub(super) fn begin_move(&mut self, now_ns: u64, path: Path, target: Pose, rate: Rate) {
        let move_index = self.accepted_move_count;
        self.accepted_move_count += 1;
        let mut target = target;
        for fault in &self.settings.faults {
            match *fault {
                Fault::Elsewhere { distance_mm, view } if view == move_index => {
                    target.position_um[2] += (distance_mm * 1000.0).round() as i32;
                }
                Fault::RobotSilent { view } if view == move_index => self.is_silent = true,
                _ => (),
            }
        }
        let rate = if self.switches.is_speed_restricted {
            rate.restricted(RESTRICTED_MM_S)
        } else {
            rate
        };
        let new = match path {
            Path::Link => Motion::link,
            Path::Straight => Motion::new,
        };
        let motion = new(now_ns, self.pose, target, rate, self.settings.speed);
        let middle_ns = motion.middle_ns();
        let incidents = self.settings.faults.iter().filter_map(|fault| match *fault {
            Fault::RobotAlarm { code, view } if view == move_index => Some(Incident::Alarm(code)),
            Fault::Estop { view } if view == move_index => Some(Incident::EmergencyStop),
            Fault::Door { view } if view == move_index => Some(Incident::Door),
            Fault::PendantHold { view } if view == move_index => Some(Incident::PendantHold),
            Fault::ServoDrop { view } if view == move_index => Some(Incident::ServoDrop),
            Fault::PowerLoss { span_s, view } if view == move_index => Some(Incident::PowerLoss(real_ns(span_s))),
            Fault::Busy { span_s, view } if view == move_index => Some(Incident::Busy(real_ns(span_s))),
            _ => None,
        });
        self.incidents.extend(incidents.map(|incident| (middle_ns, incident)));
        self.departure_count += u32::from(motion.leads_away());
        self.motion = Some(motion);
        self.last_active_ns = now_ns;
    }

    /// Where an increment leads.
    fn incremented(&self, order: &CartesianOrder) -> Answer<Pose> {
        let largest = self
            .settings
            .workspace_max_um
            .iter()
            .chain(&self.settings.workspace_min_um);
        let span_um = largest.map(|um| i64::from(*um).abs()).max().unwrap_or(0) * 2;
        let is_sane = order.pose.position_um.iter().all(|um| i64::from(*um).abs() <= span_um)
            && order
                .pose
                .turn_e4_deg
                .iter()
                .all(|turn| (-1_800_000..=1_800_000).contains(turn));
        refuse_first([(!is_sane, Refused::VALUE)])?;
        let (base_from_tool, by) = (self.pose.to_isometry(), order.pose.to_isometry());
        Ok(Pose::from_isometry(&if order.coordinate == COORDINATE_TOOL {
            base_from_tool * by
        } else {
            Isometry3::from_parts(
                (base_from_tool.translation.vector + by.translation.vector).into(),
                by.rotation * base_from_tool.rotation,
            )
        }))
    }
}

impl OrderedSpeed {
    /// B00A for none, B009 for one out of range.
    pub fn rate(self) -> Answer<Rate> {
        match (self.class, self.value) {
            (0..=2, 0) => Err(Refused::SPEED_MISSING),
            (0, 1..=10_000) => Ok(Rate::Share(f64::from(self.value) / 10_000.0)),
            (1, 1..=15_000) => Ok(Rate::ToolPoint(f64::from(self.value) * 0.1)),
            (2, 1..=1_800) => Ok(Rate::Turn((f64::from(self.value) * 0.1).to_radians())),
            _ => Err(Refused::SPEED),
        }
    }
}

fn real_ns(span_s: f64) -> u64 {
    (span_s * 1e9).round() as u64
}

/// The form that the arm is always in, as on the protocol page's vector.
pub const FORM: i32 = 4;
/// Bit of the form that says it is to be reached.
pub const FORM_IS_GIVEN: i32 = 0x80;
/// Coordinate codes.
pub const COORDINATE_BASE: i32 = 16;
/// The robot's own frame: that of the base, as there is no base axis.
pub const COORDINATE_ROBOT: i32 = 17;
/// User coordinate: none is taught.
pub const COORDINATE_USER: i32 = 18;
/// Tool coordinate: increments only.
pub const COORDINATE_TOOL: i32 = 19;
/// Fastest tool point while the speed is restricted: that of teaching.
pub const RESTRICTED_MM_S: f64 = 250.0;
