//! What instructions read and write: variables, signals, conditions.

use crate::robot::alarms::{CODE_INSTRUCTION, CODE_POSITION};
use crate::robot::controller::Controller;
use crate::robot::io::{Area, GENERAL_IN, GENERAL_OUT, Signals};
use crate::robot::job::instruction::{
    Comparison, Condition, Index, Instruction, Operand, Operation, Place, Side, SignalsAt,
};
use crate::robot::job::run::Bad;
use crate::robot::variables::{Kind, Position, Value};

impl Controller {
    /// Carries out what neither moves nor jumps.
    pub(super) fn calculate(&mut self, now_ns: u64, instruction: &Instruction) -> Result<(), Bad> {
        match *instruction {
            Instruction::Compute { operation, to, by } => self.compute(operation, to, by),
            Instruction::Clear { to, count } => self.clear(to, count),
            Instruction::CopyPosition { to, from } => {
                let position = self.position_variable(from)?;
                self.set_position(to, position)
            }
            Instruction::SetElement { to, element, from } => {
                let mut position = self.position_variable(to)?;
                let value = self.whole(from)?;
                position.axes[usize::from(element) - 1] = i32::try_from(value).map_err(|_| BAD)?;
                self.set_position(to, position)
            }
            Instruction::CurrentPosition { to, is_pulses } => {
                let position = if is_pulses {
                    self.standing_pulses(now_ns)
                } else {
                    self.standing_base(now_ns)
                };
                self.set_position(to, position)
            }
            Instruction::Out { signals, from } => self.set_output(signals, from),
            Instruction::In { to, signals } => {
                let state = self.signals_state(signals)?;
                self.store(to, state as f64)
            }
            _ => Ok(()),
        }
    }

    pub(super) fn holds(&self, condition: &Condition) -> Result<bool, Bad> {
        let (left, right) = (self.side(condition.left)?, self.side(condition.right)?);
        Ok(match condition.comparison {
            Comparison::Equal => left == right,
            Comparison::Unequal => left != right,
            Comparison::Less => left < right,
            Comparison::LessEqual => left <= right,
            Comparison::Greater => left > right,
            Comparison::GreaterEqual => left >= right,
        })
    }

    /// Value of a variable; every one of them is a number that `f64` holds exactly.
    pub(super) fn number(&self, place: Place) -> Result<f64, Bad> {
        match self.variables.read(place.kind, self.index(place.index)?) {
            Ok(Value::B(value)) => Ok(f64::from(value)),
            Ok(Value::I(value)) => Ok(f64::from(value)),
            Ok(Value::D(value)) => Ok(f64::from(value)),
            Ok(Value::R(value)) => Ok(f64::from(value)),
            _ => Err(BAD),
        }
    }

    /// Value of an operand, rounded.
    pub(super) fn whole(&self, operand: Operand) -> Result<i64, Bad> {
        Ok(self.operand(operand)?.round() as i64)
    }

    pub(super) fn index(&self, index: Index) -> Result<u16, Bad> {
        match index {
            Index::Constant(number) => Ok(number),
            Index::Variable(kind, number) => {
                let index = Index::Constant(number);
                let value = self.number(Place { kind, index })?;
                if (0.0..=f64::from(u16::MAX)).contains(&value) {
                    Ok(value as u16)
                } else {
                    Err(BAD)
                }
            }
        }
    }

    fn operand(&self, operand: Operand) -> Result<f64, Bad> {
        match operand {
            Operand::Integer(value) => Ok(value as f64),
            Operand::Real(value) => Ok(value),
            Operand::Variable(place) => self.number(place),
        }
    }

    fn compute(&mut self, operation: Operation, to: Place, by: Operand) -> Result<(), Bad> {
        let (old, by) = (self.number(to)?, self.operand(by)?);
        let bits = |value: f64| value as u8;
        let value = match operation {
            Operation::Set => by,
            Operation::Add => old + by,
            Operation::Subtract => old - by,
            Operation::Multiply => old * by,
            Operation::Divide | Operation::Modulo if by == 0.0 => return Err(BAD),
            Operation::Divide if to.kind == Kind::R => old / by,
            Operation::Divide => (old / by).trunc(),
            Operation::Modulo => old % by,
            Operation::And => f64::from(bits(old) & bits(by)),
            Operation::Or => f64::from(bits(old) | bits(by)),
            Operation::Xor => f64::from(bits(old) ^ bits(by)),
            Operation::Not => f64::from(!bits(by)),
        };
        self.store(to, value)
    }

    /// Rounds into whole numbers; out of a variable's range is an alarm.
    fn store(&mut self, to: Place, value: f64) -> Result<(), Bad> {
        let rounded = value.round();
        let whole = |range: core::ops::RangeInclusive<f64>| {
            if range.contains(&rounded) {
                Ok(rounded)
            } else {
                Err(BAD)
            }
        };
        let value = match to.kind {
            Kind::B => Value::B(whole(0.0..=255.0)? as u8),
            Kind::I => Value::I(whole(f64::from(i16::MIN)..=f64::from(i16::MAX))? as i16),
            Kind::D => Value::D(whole(f64::from(i32::MIN)..=f64::from(i32::MAX))? as i32),
            _ => Value::R(value as f32),
        };
        let index = self.index(to.index)?;
        self.variables.write(index, value).map_err(|_| BAD)
    }

    fn clear(&mut self, to: Place, count: Option<u16>) -> Result<(), Bad> {
        let first = self.index(to.index)?;
        let end = match count {
            Some(count) => usize::from(first) + usize::from(count),
            None => self.variables.count(to.kind),
        };
        (usize::from(first)..end).try_for_each(|number| {
            let index = Index::Constant(u16::try_from(number).map_err(|_| BAD)?);
            self.store(Place { kind: to.kind, index }, 0.0)
        })
    }

    fn position_variable(&self, index: Index) -> Result<Position, Bad> {
        match self.variables.read(Kind::P, self.index(index)?) {
            Ok(Value::P(position)) => Ok(position),
            _ => Err(Bad(CODE_POSITION)),
        }
    }

    fn set_position(&mut self, index: Index, position: Position) -> Result<(), Bad> {
        let index = self.index(index)?;
        self.variables.write(index, Value::P(position)).map_err(|_| BAD)
    }

    fn side(&self, side: Side) -> Result<f64, Bad> {
        match side {
            Side::Number(operand) => self.operand(operand),
            Side::Signals(signals) => Ok(self.signals_state(signals)? as f64),
        }
    }

    fn signals_state(&self, at: SignalsAt) -> Result<u8, Bad> {
        let number = self.index(at.number)?;
        if at.is_group {
            return self.signals.byte(group_byte(at, number)?).map_err(|_| BAD);
        }
        let signal = Signals::inform_signal(area(at), number).ok_or(BAD)?;
        self.signals.signal(signal).map(u8::from).map_err(|_| BAD)
    }

    fn set_output(&mut self, at: SignalsAt, from: Operand) -> Result<(), Bad> {
        let state = u8::try_from(self.whole(from)?).map_err(|_| BAD)?;
        let number = self.index(at.number)?;
        if at.is_group {
            return self.signals.set_byte(group_byte(at, number)?, state).map_err(|_| BAD);
        }
        let signal = Signals::inform_signal(area(at), number).ok_or(BAD)?;
        self.signals.set_signal(signal, state & 1 == 1).map_err(|_| BAD)
    }
}

fn area(at: SignalsAt) -> Area {
    if at.is_output { GENERAL_OUT } else { GENERAL_IN }
}

/// Byte of a group, which counts from 1.
fn group_byte(at: SignalsAt, number: u16) -> Result<u16, Bad> {
    let area = area(at);
    let byte = number.checked_sub(1).and_then(|index| area.first.checked_add(index));
    byte.filter(|byte| *byte <= area.last).ok_or(BAD)
}

const BAD: Bad = Bad(CODE_INSTRUCTION);
