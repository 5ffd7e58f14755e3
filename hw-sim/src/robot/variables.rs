//! The controller's variables and registers.

use crate::robot::refused::{Answer, Refused};

/// Kind of a variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Byte, unsigned.
    B,
    /// Integer, 16 bits.
    I,
    /// Double precision integer, 32 bits.
    D,
    /// Real, 32 bits.
    R,
    /// Text of 32 bytes; the 16-byte view is its first half.
    S,
    /// Position of the robot.
    P,
    /// Position of the base axes.
    Bp,
    /// Position of the station axes.
    Ex,
}

/// A variable's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// Of a B variable.
    B(u8),
    /// Of an I variable.
    I(i16),
    /// Of a D variable.
    D(i32),
    /// Of an R variable.
    R(f32),
    /// Of an S variable, padded with NUL.
    S([u8; 32]),
    /// Of a P variable.
    P(Position),
    /// Of a BP variable.
    Bp(AxesPosition),
    /// Of an EX variable.
    Ex(AxesPosition),
}

/// Position of the robot as HSES carries it: 13 words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Position {
    /// 0 pulses, 16 base, 17 robot, 18 user, 19 tool.
    pub kind: i32,
    /// Form bits.
    pub form: i32,
    /// Tool that the position is of.
    pub tool: i32,
    /// User coordinate, of kind 18.
    pub user: i32,
    /// Extended form bits.
    pub form_ext: i32,
    /// Pulses; or x, y, z in µm, Rx, Ry, Rz in 0.0001 degrees and two more axes.
    pub axes: [i32; 8],
}

/// Position of base or station axes: 9 words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxesPosition {
    /// 0 pulses, 16 base (base axes only).
    pub kind: i32,
    /// Pulses or µm.
    pub axes: [i32; 8],
}

/// All variables and registers. They outlive a loss of power.
#[derive(Clone, Debug)]
pub struct Variables {
    b: Vec<u8>,
    i: Vec<i16>,
    d: Vec<i32>,
    r: Vec<f32>,
    s: Vec<[u8; 32]>,
    p: Vec<Option<Position>>,
    bp: Vec<Option<AxesPosition>>,
    ex: Vec<Option<AxesPosition>>,
    registers: Vec<u16>,
}

impl Kind {
    /// Every kind, in the order of host control's numbers 0 to 7 (B I D R P BP EX S).
    pub const ALL: [Self; 8] = [Self::B, Self::I, Self::D, Self::R, Self::P, Self::Bp, Self::Ex, Self::S];
}

impl Value {
    /// Kind of variable that takes it.
    pub fn kind(&self) -> Kind {
        match self {
            Self::B(_) => Kind::B,
            Self::I(_) => Kind::I,
            Self::D(_) => Kind::D,
            Self::R(_) => Kind::R,
            Self::S(_) => Kind::S,
            Self::P(_) => Kind::P,
            Self::Bp(_) => Kind::Bp,
            Self::Ex(_) => Kind::Ex,
        }
    }

    /// Text, cut at 32 bytes.
    pub fn text(text: &[u8]) -> Self {
        let mut bytes = [0; 32];
        bytes.iter_mut().zip(text).for_each(|(to, from)| *to = *from);
        Self::S(bytes)
    }
}

impl Variables {
    /// All numbers 0, all texts empty, all positions undefined.
    pub fn new(scalar_count: u16, position_count: u16) -> Self {
        let (scalar_count, position_count) = (usize::from(scalar_count), usize::from(position_count));
        Self {
            b: vec![0; scalar_count],
            i: vec![0; scalar_count],
            d: vec![0; scalar_count],
            r: vec![0.0; scalar_count],
            s: vec![[0; 32]; scalar_count],
            p: vec![None; position_count],
            bp: vec![None; position_count],
            ex: vec![None; position_count],
            registers: vec![0; REGISTER_COUNT],
        }
    }

    /// How many variables of this kind there are.
    pub fn count(&self, kind: Kind) -> usize {
        match kind {
            Kind::B | Kind::I | Kind::D | Kind::R | Kind::S => self.b.len(),
            Kind::P | Kind::Bp | Kind::Ex => self.p.len(),
        }
    }

    /// Value of a variable; A001 for one that does not exist, B001 for a position that was never set.
    pub fn read(&self, kind: Kind, index: u16) -> Answer<Value> {
        if usize::from(index) >= self.count(kind) {
            return Err(Refused::NO_INSTANCE);
        }
        let index = usize::from(index);
        match kind {
            Kind::B => Ok(Value::B(self.b[index])),
            Kind::I => Ok(Value::I(self.i[index])),
            Kind::D => Ok(Value::D(self.d[index])),
            Kind::R => Ok(Value::R(self.r[index])),
            Kind::S => Ok(Value::S(self.s[index])),
            Kind::P => self.p[index].map(Value::P).ok_or(Refused::POSITION_UNDEFINED),
            Kind::Bp => self.bp[index].map(Value::Bp).ok_or(Refused::POSITION_UNDEFINED),
            Kind::Ex => self.ex[index].map(Value::Ex).ok_or(Refused::POSITION_UNDEFINED),
        }
    }

    /// Sets a variable; A001 for one that does not exist, B007 and B00D for a position of no type or tool, B004 for a
    /// real that is no number.
    pub fn write(&mut self, index: u16, value: Value) -> Answer<()> {
        if usize::from(index) >= self.count(value.kind()) {
            return Err(Refused::NO_INSTANCE);
        }
        check(&value)?;
        let index = usize::from(index);
        match value {
            Value::B(value) => self.b[index] = value,
            Value::I(value) => self.i[index] = value,
            Value::D(value) => self.d[index] = value,
            Value::R(value) => self.r[index] = value,
            Value::S(value) => self.s[index] = value,
            Value::P(value) => self.p[index] = Some(value),
            Value::Bp(value) => self.bp[index] = Some(value),
            Value::Ex(value) => self.ex[index] = Some(value),
        }
        Ok(())
    }

    /// Register, 0 to 999.
    pub fn register(&self, index: u16) -> Answer<u16> {
        self.registers
            .get(usize::from(index))
            .copied()
            .ok_or(Refused::NO_INSTANCE)
    }

    /// Sets a register, 0 to 559.
    pub fn set_register(&mut self, index: u16, value: u16) -> Answer<()> {
        if index >= REGISTER_WRITABLE_COUNT {
            return Err(Refused::NO_INSTANCE);
        }
        self.registers[usize::from(index)] = value;
        Ok(())
    }
}

/// Refuses values that no variable holds.
pub fn check(value: &Value) -> Answer<()> {
    match value {
        Value::R(value) if !value.is_finite() => Err(Refused::VALUE),
        Value::P(position) if !matches!(position.kind, 0 | 16..=19) => Err(Refused::POSITION_TYPE),
        Value::P(position) if !(0..TOOL_COUNT).contains(&position.tool) => Err(Refused::TOOL),
        Value::P(position) if !(0..TOOL_COUNT).contains(&position.user) => Err(Refused::USER_FRAME),
        Value::P(position) if !(0..256).contains(&position.form) || !(0..256).contains(&position.form_ext) => {
            Err(Refused::FORM)
        }
        Value::Bp(position) if !matches!(position.kind, 0 | 16) => Err(Refused::POSITION_TYPE),
        Value::Ex(position) if position.kind != 0 => Err(Refused::POSITION_TYPE),
        _ => Ok(()),
    }
}

/// Registers that can be read.
pub const REGISTER_COUNT: usize = 1000;
/// Registers that can be written.
pub const REGISTER_WRITABLE_COUNT: u16 = 560;
/// Tools, and as many user coordinates: numbers 0 to 63.
pub const TOOL_COUNT: i32 = 64;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_and_nothing_beyond_the_end() {
        let mut variables = Variables::new(100, 128);
        let position = Position {
            kind: 17,
            tool: 1,
            axes: [1, 2, 3, 4, 5, 6, 0, 0],
            ..Position::default()
        };
        for value in [
            Value::B(200),
            Value::I(-2),
            Value::D(i32::MIN),
            Value::R(1.5),
            Value::text(b"PART-0001"),
            Value::P(position),
            Value::Bp(AxesPosition::default()),
            Value::Ex(AxesPosition::default()),
        ] {
            let last = variables.count(value.kind()) as u16 - 1;
            variables.write(last, value).unwrap();
            assert_eq!(variables.read(value.kind(), last), Ok(value));
            assert_eq!(variables.write(last + 1, value), Err(Refused::NO_INSTANCE));
            assert_eq!(variables.read(value.kind(), last + 1), Err(Refused::NO_INSTANCE));
        }
    }

    #[test]
    fn a_position_that_was_never_set_is_undefined() {
        let variables = Variables::new(100, 128);
        assert_eq!(variables.read(Kind::P, 0), Err(Refused::POSITION_UNDEFINED));
        assert_eq!(variables.read(Kind::P, 128), Err(Refused::NO_INSTANCE));
    }

    #[test]
    fn a_position_of_no_type_and_a_real_that_is_no_number_are_refused() {
        let mut variables = Variables::new(1, 1);
        let position = |kind, tool| {
            Value::P(Position {
                kind,
                tool,
                ..Position::default()
            })
        };
        assert_eq!(variables.write(0, position(15, 0)), Err(Refused::POSITION_TYPE));
        assert_eq!(variables.write(0, position(16, 64)), Err(Refused::TOOL));
        assert_eq!(variables.write(0, Value::R(f32::NAN)), Err(Refused::VALUE));
    }

    #[test]
    fn registers_above_559_are_read_only() {
        let mut variables = Variables::new(1, 1);
        assert_eq!(variables.set_register(559, 7), Ok(()));
        assert_eq!(variables.register(559), Ok(7));
        assert_eq!(variables.set_register(560, 7), Err(Refused::NO_INSTANCE));
        assert_eq!(variables.register(999), Ok(0));
        assert_eq!(variables.register(1000), Err(Refused::NO_INSTANCE));
    }
}
