//! HSES requests on the robot port: each command read and carried out.

use crate::checks::refuse_first;
use crate::robot::controller::Controller;
use crate::robot::hses::{
    Refusal, Request, SERVICE_GET, SERVICE_GET_ALL, SERVICE_READ_PLURAL, SERVICE_SET, SERVICE_SET_ALL, words,
};
use crate::robot::moves::{CartesianOrder, OrderedSpeed, Path, PulseOrder};
use crate::robot::pose::Pose;
use crate::robot::refused::{Answer, Refused};
use crate::robot::switches::Cycle;

/// Data of an answer, or the refusal.
pub(super) type Reply = Result<Vec<u8>, Refusal>;

impl Controller {
    /// Carries out a request. Checked in this order: command, instance, attribute, service, data.
    pub(in crate::robot) fn reply(&mut self, now_ns: u64, request: &Request) -> Reply {
        match request.command {
            0x82..=0x87 | 0x8A | 0x8B => {
                check_target(request)?;
                self.order(now_ns, request).map(|()| Vec::new()).map_err(Refusal::from)
            }
            0x300..=0x309 | 0x30C => self.plural(now_ns, request),
            _ => self.attributes(now_ns, request),
        }
    }

    /// Reads or writes a record whole or by attribute.
    fn attributes(&mut self, now_ns: u64, request: &Request) -> Reply {
        let is_all = matches!(request.service, SERVICE_GET_ALL | SERVICE_SET_ALL);
        let is_set = matches!(request.service, SERVICE_SET | SERVICE_SET_ALL);
        let layout = self.layout(request.command).ok_or(Refusal::UndefinedCommand)?;
        if is_set && layout.access == Access::Write {
            if !attribute_fits(request, layout.field_count) {
                return Err(Refusal::InvalidAttribute);
            }
            refuse_first([(!is_all && layout.is_all_only, Refusal::UndefinedCommand)])?;
            let sets_word = !is_all && layout.field_count > 1;
            if sets_word {
                self.set_word(now_ns, request)?;
            } else {
                self.set_record(now_ns, request)?;
            }
            return Ok(Vec::new());
        }
        // An undefined position exists: its attribute and service are checked like any other's.
        let fields = self.record(now_ns, request.command, request.instance);
        if let Err(Refusal::NoInstance | Refusal::UndefinedCommand) = fields {
            return fields.map(|_| Vec::new());
        }
        let is_get = matches!(request.service, SERVICE_GET | SERVICE_GET_ALL) && (is_all || !layout.is_all_only);
        refuse_first([
            (!attribute_fits(request, layout.field_count), Refusal::InvalidAttribute),
            (!is_get, Refusal::UndefinedCommand),
            (!request.data.is_empty(), Refused::DATA_SIZE.into()),
        ])?;
        let fields = fields?;
        Ok(if is_all {
            fields.concat()
        } else {
            fields[usize::from(request.attribute) - 1].clone()
        })
    }

    fn layout(&self, command: u16) -> Option<Layout> {
        let (field_count, access) = match command {
            0x70 | 0x71 => (5, Access::Read),
            0x72 | 0x88 => (2, Access::Read),
            0x73 => (4, Access::Read),
            0x74 | 0x76 | 0x77 | 0x30A | 0x30B => (8, Access::Read),
            0x75 => (13, Access::Read),
            0x89 => (3, Access::Read),
            0x78..=0x7E | 0x8C => (1, Access::Write),
            0x7F => (13, Access::Write),
            0x80 | 0x81 => (9, Access::Write),
            _ => return None,
        };
        Some(Layout {
            field_count,
            access,
            // The manual has P variables whole only; some clients ask for one attribute. The manual is followed.
            is_all_only: command == 0x7F,
        })
    }

    fn order(&mut self, now_ns: u64, request: &Request) -> Answer<()> {
        match (request.command, request.instance) {
            (0x82, instance) => {
                value(request, 1)?;
                if instance == INSTANCE_ALARM_RESET {
                    self.reset_alarms(now_ns)
                } else {
                    self.cancel_error(now_ns)
                }
            }
            (0x83, instance) => {
                let is_on = value(request, 2)? == SWITCH_ON;
                match instance {
                    INSTANCE_HOLD => self.set_hold(now_ns, is_on),
                    INSTANCE_SERVO => self.set_servo(now_ns, is_on),
                    _ => self.set_pendant_lock(now_ns, is_on),
                }
            }
            (0x84, _) => {
                let cycle = match value(request, 3)? {
                    1 => Cycle::Step,
                    2 => Cycle::Once,
                    _ => Cycle::Auto,
                };
                self.set_cycle(now_ns, cycle)
            }
            (0x85, _) => {
                let field: &[u8; 32] = request.data.as_slice().try_into().map_err(|_| Refused::DATA_SIZE)?;
                let shown = field.split(|byte| *byte == 0).next().unwrap_or_default();
                self.show_text(now_ns, shown).map_err(|_| Refused::VALUE)
            }
            (0x86, _) => {
                value(request, 1)?;
                self.start(now_ns, None)
            }
            (0x87, instance) => self.select(now_ns, instance, &request.data),
            (0x8A, instance) => self.accept_cartesian(now_ns, instance, &request.data),
            (_, instance) => self.accept_pulses(now_ns, instance, &request.data),
        }
    }

    fn select(&mut self, now_ns: u64, instance: u16, data: &[u8]) -> Answer<()> {
        let (name, line) = data.split_at_checked(32).ok_or(Refused::DATA_SIZE)?;
        let [line]: [i32; 1] = words(line).ok_or(Refused::DATA_SIZE)?;
        let name = name.split(|byte| *byte == 0).next().unwrap_or_default();
        let name = core::str::from_utf8(name).map_err(|_| Refused::NO_SUCH_JOB)?;
        let line = u32::try_from(line)
            .ok()
            .filter(|line| *line <= LINE_MAX)
            .ok_or(Refused::VALUE)?;
        if instance == INSTANCE_EXECUTION {
            self.select_job(now_ns, name, line)
        } else {
            self.set_master_job(now_ns, instance - INSTANCE_MASTER, name)
        }
    }

    fn accept_cartesian(&mut self, now_ns: u64, instance: u16, data: &[u8]) -> Answer<()> {
        self.check_can_move(now_ns)?;
        let fields: [i32; 26] = words(data).ok_or(Refused::DATA_SIZE)?;
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
            form_ext,
            tool,
            user,
            others @ ..,
        ] = fields;
        let is_else_zero = reserve_1 == 0 && reserve_2 == 0 && others.iter().all(|other| *other == 0);
        check_groups(robot, station, is_else_zero)?;
        self.move_cartesian(
            now_ns,
            &CartesianOrder {
                path: if instance == 1 { Path::Link } else { Path::Straight },
                is_increment: instance == 3,
                speed: OrderedSpeed { class, value: speed },
                coordinate,
                pose: Pose::from_pulses([x, y, z, rx, ry, rz]),
                form,
                form_ext,
                tool,
                user,
            },
        )
    }

    fn accept_pulses(&mut self, now_ns: u64, instance: u16, data: &[u8]) -> Answer<()> {
        self.check_can_move(now_ns)?;
        let fields: [i32; 22] = words(data).ok_or(Refused::DATA_SIZE)?;
        let [
            robot,
            station,
            class,
            speed,
            s,
            l,
            u,
            r,
            b,
            t,
            axis_7,
            axis_8,
            tool,
            others @ ..,
        ] = fields;
        check_groups(robot, station, others.iter().all(|other| *other == 0))?;
        self.move_pulses(
            now_ns,
            &PulseOrder {
                path: if instance == 1 { Path::Link } else { Path::Straight },
                speed: OrderedSpeed { class, value: speed },
                pulses: [s, l, u, r, b, t, axis_7, axis_8],
                tool,
            },
        )
    }
}

/// Fields of a record.
#[derive(Clone, Copy)]
struct Layout {
    field_count: u8,
    access: Access,
    is_all_only: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Access {
    Read,
    Write,
}

/// Attribute 0 with "all", 1 to the last with "one". Under an unknown service every attribute that exists will do.
fn attribute_fits(request: &Request, field_count: u8) -> bool {
    match request.service {
        SERVICE_GET_ALL | SERVICE_SET_ALL => request.attribute == 0,
        SERVICE_GET | SERVICE_SET => (1..=field_count).contains(&request.attribute),
        _ => request.attribute <= field_count,
    }
}

/// Instance, attribute and service of an order, in this order.
fn check_target(request: &Request) -> Result<(), Refusal> {
    let (instances, attributes, service): (core::ops::RangeInclusive<u16>, &[u8], u8) = match request.command {
        0x82 => (1..=2, &[1], SERVICE_SET),
        0x83 => (1..=3, &[1], SERVICE_SET),
        0x84 => (2..=2, &[1], SERVICE_SET),
        0x87 => (1..=25, &[0], SERVICE_SET_ALL),
        // Both public clients send the moves with attribute 1 although the service is "all"; 0 is taken too.
        0x8A => (1..=3, &[0, 1], SERVICE_SET_ALL),
        0x8B => (1..=2, &[0, 1], SERVICE_SET_ALL),
        _ => (1..=1, &[1], SERVICE_SET),
    };
    let is_between = request.command == 0x87 && (2..INSTANCE_MASTER).contains(&request.instance);
    refuse_first([
        (
            !instances.contains(&request.instance) || is_between,
            Refusal::NoInstance,
        ),
        (!attributes.contains(&request.attribute), Refusal::InvalidAttribute),
        (request.service != service, Refusal::UndefinedCommand),
    ])
}

fn check_groups(robot: i32, station: i32, is_else_zero: bool) -> Answer<()> {
    refuse_first([
        (robot != 0 && station != 0, Refused::GROUP),
        (robot != 1 || !is_else_zero, Refused::VALUE),
    ])
}

/// Word 1 to `largest`.
fn value(request: &Request, largest: i32) -> Answer<i32> {
    match words(&request.data) {
        Some([value]) if (1..=largest).contains(&value) => Ok(value),
        Some(_) => Err(Refused::VALUE),
        None => Err(Refused::DATA_SIZE),
    }
}

/// Whether a request only reads.
pub(in crate::robot) fn is_read(request: &Request) -> bool {
    matches!(request.service, SERVICE_GET | SERVICE_GET_ALL | SERVICE_READ_PLURAL)
}

const INSTANCE_HOLD: u16 = 1;
const INSTANCE_SERVO: u16 = 2;
const INSTANCE_ALARM_RESET: u16 = 1;
const INSTANCE_EXECUTION: u16 = 1;
/// Master job of task 0.
const INSTANCE_MASTER: u16 = 10;
const SWITCH_ON: i32 = 1;
const LINE_MAX: u32 = 9999;

#[cfg(test)]
#[path = "commands_tests.rs"]
mod tests;
