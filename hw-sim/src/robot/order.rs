//! What a request must look like: its target, its value, and the fields of a move. Refusals are those of the page.

use crate::checks::refuse_first;
use crate::robot::controller::Settings;
use crate::robot::hses::{self, Refusal, Request};
use crate::robot::motion::Rate;
use crate::robot::pose::Pose;

/// A move whose fields are all acceptable.
pub(super) struct MoveOrder {
    pub(super) target: Pose,
    pub(super) rate: Rate,
    pub(super) tool: i32,
}

impl MoveOrder {
    /// Checks the fields of section 4 of the page.
    pub(super) fn read(request: &Request, settings: &Settings) -> Result<Self, Refusal> {
        let fields: [i32; 26] = hses::words(&request.data).ok_or(Refusal::Failed(DATA_SIZE))?;
        let [
            robot,
            station,
            class,
            speed,
            coordinate,
            x,
            y,
            z,
            rx,
            ry,
            rz,
            reserve_1,
            reserve_2,
            form,
            form_2,
            tool,
            user,
            others @ ..,
        ] = fields;
        if robot != 0 && station != 0 {
            return Err(Refusal::Failed(TWO_GROUPS));
        }
        let rate = rate(class, speed)?;
        let position_um = [x, y, z];
        let turn_e4_deg = [rx, ry, rz];
        let is_inside = (0..3).all(|axis| {
            (settings.workspace_min_um[axis]..=settings.workspace_max_um[axis]).contains(&position_um[axis])
        });
        let is_turn = turn_e4_deg.iter().all(|turn| (-1_800_000..=1_800_000).contains(turn));
        let is_known = matches!(coordinate, COORDINATE_BASE | COORDINATE_ROBOT);
        let is_else_zero = reserve_1 == 0 && reserve_2 == 0 && others.iter().all(|other| *other == 0);
        refuse_first([
            (!is_known, Refusal::Failed(COORDINATE)),
            (form != 0 || form_2 != 0, Refusal::Failed(FORM_REFUSED)),
            (!(0..=63).contains(&tool), Refusal::Failed(TOOL)),
            (user != 0, Refusal::Failed(USER)),
            (robot != 1 || !is_else_zero, Refusal::Failed(VALUE)),
            (!is_inside || !is_turn, Refusal::Failed(VALUE)),
        ])?;
        Ok(Self {
            target: Pose {
                position_um,
                turn_e4_deg,
            },
            rate,
            tool,
        })
    }
}

fn rate(class: i32, speed: i32) -> Result<Rate, Refusal> {
    match (class, speed) {
        (0..=2, 0) => Err(Refusal::Failed(SPEED_MISSING)),
        (0, 1..=10_000) => Ok(Rate::Share(f64::from(speed) / 10_000.0)),
        (1, 1..=15_000) => Ok(Rate::ToolPoint(f64::from(speed) * 0.1)),
        (2, 1..=1_800) => Ok(Rate::Turn((f64::from(speed) * 0.1).to_radians())),
        _ => Err(Refusal::Failed(SPEED)),
    }
}

/// Command, instance, attribute and service, in this order.
pub(super) fn check_target(request: &Request) -> Result<(), Refusal> {
    let (instances, attributes, service): (&[u16], &[u8], u8) = match request.command {
        hses::COMMAND_ALARM => (&[1, 2, 3, 4], &[0], hses::SERVICE_GET_ALL),
        hses::COMMAND_STATUS => (&[1], &[0], hses::SERVICE_GET_ALL),
        hses::COMMAND_POSITION => (&[INSTANCE_PULSES, 101], &[0], hses::SERVICE_GET_ALL),
        hses::COMMAND_RESET => (&[INSTANCE_ALARM_RESET, 2], &[1], hses::SERVICE_SET),
        hses::COMMAND_SWITCH => (&[INSTANCE_HOLD, 2], &[1], hses::SERVICE_SET),
        hses::COMMAND_SYSTEM => (&[11], &[0], hses::SERVICE_GET_ALL),
        hses::COMMAND_MOVE => (&[2], &[0, 1], hses::SERVICE_SET_ALL),
        _ => return Err(Refusal::UndefinedCommand),
    };
    refuse_first([
        (!instances.contains(&request.instance), Refusal::NoInstance),
        (!attributes.contains(&request.attribute), Refusal::InvalidAttribute),
        (request.service != service, Refusal::UndefinedCommand),
    ])
}

pub(super) fn no_data(request: &Request) -> Result<(), Refusal> {
    refuse_first([(!request.data.is_empty(), Refusal::Failed(DATA_SIZE))])
}

/// 1 or 2.
pub(super) fn switch_value(request: &Request) -> Result<i32, Refusal> {
    match hses::words(&request.data) {
        Some([value @ 1..=2]) => Ok(value),
        Some(_) => Err(Refusal::Failed(VALUE)),
        None => Err(Refusal::Failed(DATA_SIZE)),
    }
}

pub(super) const INSTANCE_HOLD: u16 = 1;
pub(super) const INSTANCE_ALARM_RESET: u16 = 1;
pub(super) const INSTANCE_PULSES: u16 = 1;
pub(super) const SWITCH_ON: i32 = 1;
const COORDINATE_BASE: i32 = 16;
const COORDINATE_ROBOT: i32 = 17;

pub(super) const MOVING: u16 = 0x2010;
pub(super) const HELD_BY_PENDANT: u16 = 0x2020;
pub(super) const HELD_BY_COMMAND: u16 = 0x2050;
pub(super) const ALARM_PRESENT: u16 = 0x2060;
pub(super) const SERVO_OFF: u16 = 0x2070;
pub(super) const WRONG_MODE: u16 = 0x2080;
pub(super) const NOT_REMOTE: u16 = 0x2100;
pub(super) const SERVO_REFUSED: u16 = 0x3450;
const DATA_SIZE: u16 = 0xB003;
pub(super) const VALUE: u16 = 0xB004;
const TWO_GROUPS: u16 = 0xB008;
const SPEED: u16 = 0xB009;
const SPEED_MISSING: u16 = 0xB00A;
const COORDINATE: u16 = 0xB00B;
const FORM_REFUSED: u16 = 0xB00C;
const TOOL: u16 = 0xB00D;
const USER: u16 = 0xB00E;
