//! HSES requests on the robot port: each command read and carried out.

use crate::checks::refuse_first;
use crate::robot::controller::Controller;
use crate::robot::hses::{self, Refusal, Request};
use crate::robot::moves::{CartesianOrder, OrderedSpeed, Path};
use crate::robot::pose::Pose;
use crate::robot::refused::Refused;
use crate::robot::variables::Position;

/// Data of an answer, or the refusal.
pub(super) type Reply = Result<Vec<u8>, Refusal>;

impl Controller {
    pub(super) fn reply(&mut self, now_ns: u64, request: &Request) -> Reply {
        check_target(request)?;
        match (request.command, request.instance) {
            (hses::COMMAND_ALARM, number) => {
                no_data(request)?;
                Ok(hses::alarm_data(self.alarm(now_ns, number)?.as_ref()))
            }
            (hses::COMMAND_STATUS, _) => {
                no_data(request)?;
                let [word_1, word_2] = self.status(now_ns);
                Ok(hses::status_data(word_1, word_2))
            }
            (hses::COMMAND_POSITION, instance) => {
                no_data(request)?;
                let position = if instance == INSTANCE_PULSES {
                    self.position_pulses(now_ns)
                } else {
                    self.position_base(now_ns)
                };
                Ok(position_data(&position))
            }
            (hses::COMMAND_SYSTEM, _) => {
                no_data(request)?;
                let system = self.system_information();
                Ok(hses::system_data(system.software, system.model, system.parameters))
            }
            (hses::COMMAND_RESET, instance) => {
                if switch_value(request)? != SWITCH_ON {
                    return Err(Refused::VALUE.into());
                }
                if instance == INSTANCE_ALARM_RESET {
                    self.reset_alarms(now_ns)?;
                } else {
                    self.cancel_error(now_ns)?;
                }
                Ok(Vec::new())
            }
            (hses::COMMAND_SWITCH, INSTANCE_HOLD) => {
                self.set_hold(now_ns, switch_value(request)? == SWITCH_ON)?;
                Ok(Vec::new())
            }
            (hses::COMMAND_SWITCH, _) => {
                self.set_servo(now_ns, switch_value(request)? == SWITCH_ON)?;
                Ok(Vec::new())
            }
            (hses::COMMAND_MOVE, _) => self.accept_move(now_ns, request),
            _ => Err(Refusal::UndefinedCommand),
        }
    }

    fn accept_move(&mut self, now_ns: u64, request: &Request) -> Reply {
        self.check_can_move(now_ns)?;
        let fields: [i32; 26] = hses::words(&request.data).ok_or(Refused::DATA_SIZE)?;
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
        refuse_first([
            (robot != 0 && station != 0, Refused::GROUP),
            (robot != 1 || !is_else_zero, Refused::VALUE),
        ])?;
        self.move_cartesian(
            now_ns,
            &CartesianOrder {
                path: Path::Straight,
                is_increment: false,
                speed: OrderedSpeed { class, value: speed },
                coordinate,
                pose: Pose {
                    position_um: [x, y, z],
                    turn_e4_deg: [rx, ry, rz],
                },
                form,
                form_ext,
                tool,
                user,
            },
        )?;
        Ok(Vec::new())
    }
}

fn position_data(position: &Position) -> Vec<u8> {
    let head = [
        position.kind,
        position.form,
        position.tool,
        position.user,
        position.form_ext,
    ];
    let mut data = hses::words_data(&head);
    data.extend(hses::words_data(&position.axes));
    data
}

/// Command, instance, attribute and service, in this order.
fn check_target(request: &Request) -> Result<(), Refusal> {
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

fn no_data(request: &Request) -> Result<(), Refusal> {
    refuse_first([(!request.data.is_empty(), Refused::DATA_SIZE.into())])
}

/// 1 or 2.
fn switch_value(request: &Request) -> Result<i32, Refusal> {
    match hses::words(&request.data) {
        Some([value @ 1..=2]) => Ok(value),
        Some(_) => Err(Refused::VALUE.into()),
        None => Err(Refused::DATA_SIZE.into()),
    }
}

const INSTANCE_HOLD: u16 = 1;
const INSTANCE_ALARM_RESET: u16 = 1;
const INSTANCE_PULSES: u16 = 1;
const SWITCH_ON: i32 = 1;
