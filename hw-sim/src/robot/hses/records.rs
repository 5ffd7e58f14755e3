//! Commands whose data are a record of fields: each readable whole or by attribute, some writable.

use crate::robot::alarms::{Alarm, AlarmGroup};
use crate::robot::axes::{AXIS_NAMES, COORDINATE_NAMES};
use crate::robot::controller::Controller;
use crate::robot::hses::{Refusal, Request, text, words};
use crate::robot::refused::Refused;
use crate::robot::status::ManagementTime;
use crate::robot::variables::{AxesPosition, Kind, Position, Value};

/// Fields of a record in the order of their attributes, the first of attribute 1.
pub(super) type Fields = Vec<Vec<u8>>;

impl Controller {
    /// Record of a command that is read, or the refusal of the command or its instance.
    pub(super) fn record(&mut self, now_ns: u64, command: u16, instance: u16) -> Result<Fields, Refusal> {
        match command {
            0x70 | 0x30A => {
                self.check_sub_texts(command)?;
                let alarm = self.alarm(now_ns, instance).map_err(no_instance)?;
                Ok(alarm_fields(alarm.as_ref(), command == 0x30A))
            }
            0x71 | 0x30B => {
                self.check_sub_texts(command)?;
                let (group, number) = history_place(instance)?;
                let alarm = self.alarm_history(now_ns, group, number).map_err(no_instance)?;
                Ok(alarm_fields(alarm.as_ref(), command == 0x30B))
            }
            0x72 => {
                only(&[1], instance)?;
                Ok(self.status(now_ns).map(|word| word.to_le_bytes().to_vec()).to_vec())
            }
            0x73 => {
                only(&[1], instance)?;
                let job = self.executing_job(now_ns);
                let mut fields = vec![text(&job.name, 32)];
                fields.extend([job.line, job.step, job.override_e2_percent].map(|word| word.to_le_bytes().to_vec()));
                Ok(fields)
            }
            0x74 => {
                only(&[1, 101, 111], instance)?;
                let names = if instance == 1 { AXIS_NAMES } else { COORDINATE_NAMES };
                let names = names.into_iter().chain([""; 2]);
                Ok(names.map(|name| text(name, 4)).collect())
            }
            0x75 => {
                only(&[1, 101], instance)?;
                Ok(position_fields(&if instance == 1 {
                    self.position_pulses(now_ns)
                } else {
                    self.position_base(now_ns)
                }))
            }
            0x76 => only(&[1], instance).map(|()| word_fields(&self.position_error(now_ns))),
            0x77 => only(&[1], instance).map(|()| word_fields(&self.torque_percent(now_ns))),
            // Outside its areas a signal is refused by 0x1F with A001: the sheet says so of signals alone.
            0x78 => Ok(vec![vec![self.signal_byte(now_ns, instance)?]]),
            0x79 => {
                let value = self.register(now_ns, instance).map_err(no_instance)?;
                Ok(vec![value.to_le_bytes().to_vec()])
            }
            0x88 => Ok(time_fields(
                &self.management_time(now_ns, instance).map_err(no_instance)?,
            )),
            0x89 => {
                only(&[11, 101], instance)?;
                let system = self.system_information();
                Ok(vec![
                    text(system.software, 24),
                    text(system.model, 16),
                    text(system.parameters, 8),
                ])
            }
            _ => {
                let (kind, _) = self.kind(command)?;
                let value = self.variable(now_ns, kind, instance).map_err(no_instance)?;
                Ok(value_fields(&value, command))
            }
        }
    }

    /// Sets a variable, a register or eight inputs whole.
    pub(super) fn set_record(&mut self, now_ns: u64, request: &Request) -> Result<(), Refusal> {
        let (instance, data) = (request.instance, &request.data);
        match request.command {
            0x78 => {
                let value = self.scalar(request, 1, 0..=255)?;
                Ok(self.set_signal_byte(now_ns, instance, value as u8)?)
            }
            0x79 => {
                let value = self.scalar(request, 2, 0..=65_535)?;
                self.set_register(now_ns, instance, value as u16).map_err(no_instance)
            }
            command => {
                let value = match self.kind(command)? {
                    (Kind::B, _) => Value::B(self.scalar(request, 1, 0..=255)? as u8),
                    (Kind::I, _) => Value::I(self.scalar(request, 2, -32_768..=32_767)? as i16),
                    (kind, byte_count) if data.len() == byte_count => value_of(kind, data).ok_or(Refused::DATA_SIZE)?,
                    _ => return Err(Refused::DATA_SIZE.into()),
                };
                self.set_variable(now_ns, instance, value).map_err(no_instance)
            }
        }
    }

    /// Sets one word of a base or station position.
    pub(super) fn set_word(&mut self, now_ns: u64, request: &Request) -> Result<(), Refusal> {
        let (kind, _) = self.kind(request.command)?;
        let [word]: [i32; 1] = words(&request.data).ok_or(Refused::DATA_SIZE)?;
        let old = match self.variable(now_ns, kind, request.instance) {
            Ok(Value::Bp(position) | Value::Ex(position)) => position,
            Ok(_) | Err(Refused::POSITION_UNDEFINED) => AxesPosition::default(),
            Err(refused) => return Err(no_instance(refused)),
        };
        let mut position = old;
        match usize::from(request.attribute) {
            1 => position.kind = word,
            attribute @ 2..=9 => position.axes[attribute - 2] = word,
            _ => return Err(Refusal::InvalidAttribute),
        }
        let value = if kind == Kind::Bp {
            Value::Bp(position)
        } else {
            Value::Ex(position)
        };
        self.set_variable(now_ns, request.instance, value).map_err(no_instance)
    }

    /// Kind of variable that a command is for, single or plural, and the bytes of one on the wire.
    pub(super) fn kind(&self, command: u16) -> Result<(Kind, usize), Refusal> {
        Ok(match command {
            0x7A | 0x302 => (Kind::B, 1),
            0x7B | 0x303 => (Kind::I, 2),
            0x7C | 0x304 => (Kind::D, 4),
            0x7D | 0x305 => (Kind::R, 4),
            0x7E | 0x306 => (Kind::S, 16),
            // The sources disagree whether a DX200 has texts of 32 bytes: an option, off by default.
            0x8C | 0x30C if self.settings.options.has_long_strings => (Kind::S, 32),
            0x7F | 0x307 => (Kind::P, 52),
            0x80 | 0x308 => (Kind::Bp, 36),
            0x81 | 0x309 => (Kind::Ex, 36),
            _ => return Err(Refusal::UndefinedCommand),
        })
    }

    fn check_sub_texts(&self, command: u16) -> Result<(), Refusal> {
        if command < 0x300 || self.settings.options.has_alarm_sub_texts {
            Ok(())
        } else {
            Err(Refusal::UndefinedCommand)
        }
    }

    /// A number of `native` bytes, or of 4 where it is the same number: the public clients disagree, so that both are
    /// taken and the other one is told.
    fn scalar(
        &mut self,
        request: &Request,
        native: usize,
        range: core::ops::RangeInclusive<i64>,
    ) -> Result<i64, Refusal> {
        let is_signed = *range.start() < 0;
        let data = request.data.as_slice();
        let value = match (data, is_signed) {
            _ if data.len() < native => return Err(Refused::DATA_SIZE.into()),
            (&[a], false) => i64::from(a),
            (&[a, b], false) => i64::from(u16::from_le_bytes([a, b])),
            (&[a, b], true) => i64::from(i16::from_le_bytes([a, b])),
            (&[a, b, c, d], false) => i64::from(u32::from_le_bytes([a, b, c, d])),
            (&[a, b, c, d], true) => i64::from(i32::from_le_bytes([a, b, c, d])),
            _ => return Err(Refused::DATA_SIZE.into()),
        };
        if !range.contains(&value) {
            return Err(Refused::VALUE.into());
        }
        if request.data.len() != native {
            let (command, found) = (request.command, request.data.len());
            self.violation(format!(
                "hses: {command:#x} writes {found} bytes where {native} are one"
            ));
        }
        Ok(value)
    }
}

/// A001 of a variable, register or alarm is the status 0x28.
pub(super) fn no_instance(refused: Refused) -> Refusal {
    match refused {
        Refused::NO_INSTANCE => Refusal::NoInstance,
        refused => refused.into(),
    }
}

/// Bytes of a value as a command carries it.
pub(super) fn value_fields(value: &Value, command: u16) -> Fields {
    match value {
        Value::B(value) => vec![vec![*value]],
        Value::I(value) => vec![value.to_le_bytes().to_vec()],
        Value::D(value) => vec![value.to_le_bytes().to_vec()],
        Value::R(value) => vec![value.to_le_bytes().to_vec()],
        Value::S(value) if matches!(command, 0x8C | 0x30C) => vec![value.to_vec()],
        Value::S(value) => vec![value[..16].to_vec()],
        Value::P(position) => position_fields(position),
        Value::Bp(position) | Value::Ex(position) => {
            let mut fields = word_fields(&[position.kind]);
            fields.extend(word_fields(&position.axes));
            fields
        }
    }
}

/// Value of a kind from its native bytes.
pub(super) fn value_of(kind: Kind, data: &[u8]) -> Option<Value> {
    Some(match kind {
        Kind::B => Value::B(*data.first()?),
        Kind::I => Value::I(i16::from_le_bytes(data.try_into().ok()?)),
        Kind::D => Value::D(i32::from_le_bytes(data.try_into().ok()?)),
        Kind::R => Value::R(f32::from_le_bytes(data.try_into().ok()?)),
        Kind::S => Value::text(data),
        Kind::P => {
            let [kind, form, tool, user, form_ext, axes @ ..] = words::<13>(data)?;
            Value::P(Position {
                kind,
                form,
                tool,
                user,
                form_ext,
                axes,
            })
        }
        Kind::Bp | Kind::Ex => {
            let [position_kind, axes @ ..] = words::<9>(data)?;
            let position = AxesPosition {
                kind: position_kind,
                axes,
            };
            if kind == Kind::Bp {
                Value::Bp(position)
            } else {
                Value::Ex(position)
            }
        }
    })
}

fn word_fields(words: &[i32]) -> Fields {
    words.iter().map(|word| word.to_le_bytes().to_vec()).collect()
}

fn position_fields(position: &Position) -> Fields {
    let mut fields = word_fields(&[
        position.kind,
        position.form,
        position.tool,
        position.user,
        position.form_ext,
    ]);
    fields.extend(word_fields(&position.axes));
    fields
}

/// All 0 where there is no alarm.
fn alarm_fields(alarm: Option<&Alarm>, with_sub_texts: bool) -> Fields {
    let [code, data, kind] = alarm.map_or([0; 3], |alarm| [alarm.code, alarm.data, ALARM_TYPE]);
    let mut fields: Fields = [code, data, kind].map(|word| word.to_le_bytes().to_vec()).to_vec();
    fields.push(text(&alarm.map_or_else(String::new, Alarm::time), 16));
    fields.push(text(alarm.map_or("", Alarm::name), 32));
    if with_sub_texts {
        fields.extend([16, 96, 96].map(|byte_count| vec![0; byte_count]));
    }
    fields
}

fn time_fields(time: &ManagementTime) -> Fields {
    let seconds = time.elapsed_ns / 1_000_000_000;
    let (hours, minutes) = (seconds / 3600, seconds / 60 % 60);
    vec![
        text(&crate::robot::alarms::controller_time(time.start_ns), 16),
        text(&format!("{hours:06}:{minutes:02}'{:02}", seconds % 60), 12),
    ]
}

fn history_place(instance: u16) -> Result<(AlarmGroup, u16), Refusal> {
    let group = match instance / 1000 {
        0 => AlarmGroup::Major,
        1 => AlarmGroup::Minor,
        2 => AlarmGroup::UserSystem,
        3 => AlarmGroup::UserUser,
        4 => AlarmGroup::Offline,
        _ => return Err(Refusal::NoInstance),
    };
    Ok((group, instance % 1000))
}

fn only(instances: &[u16], instance: u16) -> Result<(), Refusal> {
    if instances.contains(&instance) {
        Ok(())
    } else {
        Err(Refusal::NoInstance)
    }
}

/// Type of every alarm, as in the page's vector.
const ALARM_TYPE: u32 = 1;
