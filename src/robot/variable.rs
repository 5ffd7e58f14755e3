//! Variables of the controller's jobs, and names of jobs.

use super::pose::WirePose;
use std::fmt;
use thiserror::Error;

/// Which variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Variable {
    /// Of which kind.
    pub kind: VariableKind,
    /// Its number.
    pub index: u16,
}

/// Kinds of variables, by the manuals' letters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VariableKind {
    /// B: 0 to 255.
    Byte,
    /// I: 16 bits, signed.
    Integer,
    /// D: 32 bits, signed.
    Double,
    /// R: 32-bit floating point.
    Real,
    /// S: 16 bytes of text.
    Text,
    /// P: a position of the robot.
    Position,
    /// M: a register of 16 bits, unsigned, shared with the controller's ladder program; 0 to 999, of which a client
    /// may write 0 to 559.
    Register,
}

/// Values of one kind, in the order of their variables.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// B.
    Byte(Vec<u8>),
    /// I.
    Integer(Vec<i16>),
    /// D.
    Double(Vec<i32>),
    /// R.
    Real(Vec<f32>),
    /// S; at most 16 printable ASCII characters each.
    Text(Vec<String>),
    /// P.
    Position(Vec<PositionVariable>),
    /// M.
    Register(Vec<u16>),
}

/// The value of a P variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PositionVariable {
    /// Never written.
    Unset,
    /// Axes in pulses: S L U R B T E W.
    Pulses {
        /// The axes.
        pulses: [i32; 8],
        /// Tool number, 0 to 63.
        tool: u8,
    },
    /// A pose.
    Cartesian {
        /// In which frame.
        frame: Frame,
        /// `frame_from_tool`.
        pose: WirePose,
        /// The arm's configuration.
        form: Form,
        /// Tool number, 0 to 63.
        tool: u8,
    },
}

/// The frame of a cartesian position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame {
    /// The base: the robot's own frame unless it stands on a track.
    Base,
    /// The robot.
    Robot,
    /// A user frame, by its number.
    User(u8),
    /// The tool.
    Tool,
}

/// The arm's configuration for a pose that it can take in several ways, in the bit order of HSES.
///
/// Bit 0 back, 1 lower, 2 no flip, 3 R ≥ 180°, 4 T ≥ 180°, 5 S ≥ 180°. Host control writes them in another order:
/// [`Form::host_bits`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Form(pub u8);

impl Form {
    /// The bits in host control's order: no flip, lower, back, R, T, S.
    pub fn host_bits(self) -> u8 {
        let Self(bits) = self;
        (bits & 0b11_1000) | (bits >> 2 & 1) | (bits & 0b10) | (bits & 1) << 2
    }

    /// The configuration that host control writes as `bits`.
    pub fn from_host_bits(bits: u8) -> Self {
        // Front/back and flip change places; the rest stays.
        Self(Self(bits).host_bits())
    }
}

impl Values {
    /// Of which kind.
    pub fn kind(&self) -> VariableKind {
        match self {
            Self::Byte(_) => VariableKind::Byte,
            Self::Integer(_) => VariableKind::Integer,
            Self::Double(_) => VariableKind::Double,
            Self::Real(_) => VariableKind::Real,
            Self::Text(_) => VariableKind::Text,
            Self::Position(_) => VariableKind::Position,
            Self::Register(_) => VariableKind::Register,
        }
    }

    /// How many.
    pub fn count(&self) -> usize {
        match self {
            Self::Byte(values) => values.len(),
            Self::Integer(values) => values.len(),
            Self::Double(values) => values.len(),
            Self::Real(values) => values.len(),
            Self::Text(values) => values.len(),
            Self::Position(values) => values.len(),
            Self::Register(values) => values.len(),
        }
    }
}

impl fmt::Display for Variable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let letter = match self.kind {
            VariableKind::Byte => 'B',
            VariableKind::Integer => 'I',
            VariableKind::Double => 'D',
            VariableKind::Real => 'R',
            VariableKind::Text => 'S',
            VariableKind::Position => 'P',
            VariableKind::Register => 'M',
        };
        write!(f, "{letter}{:03}", self.index)
    }
}

/// The name of a job: 1 to 32 bytes of letters, digits, hyphens and underscores, without extension.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobName(String);

/// A text that cannot name a job.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{0:?} cannot name a job: 1 to 32 letters, digits, hyphens and underscores, without extension")]
pub struct JobNameError(pub String);

impl JobName {
    /// Reads a name.
    ///
    /// # Errors
    ///
    /// The text is empty, too long, or has other characters.
    pub fn parse(text: &str) -> Result<Self, JobNameError> {
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_');
        if (1..=32).contains(&text.len()) && text.bytes().all(plain) {
            Ok(Self(text.to_owned()))
        } else {
            Err(JobNameError(text.to_owned()))
        }
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for JobName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn host_control_writes_the_configuration_in_another_order() {
        // HSES: back 1, lower 2, no flip 4; host control: no flip 1, lower 2, back 4; R, T, S alike.
        assert_eq!(Form(0b00_0001).host_bits(), 0b00_0100);
        assert_eq!(Form(0b00_0010).host_bits(), 0b00_0010);
        assert_eq!(Form(0b10_1100).host_bits(), 0b10_1001);
        for bits in 0..64 {
            assert_eq!(Form::from_host_bits(Form(bits).host_bits()), Form(bits));
        }
    }

    #[test]
    fn names_of_jobs_are_short_and_plain() {
        assert_eq!(JobName::parse("SCAN-1_A").unwrap().as_str(), "SCAN-1_A");
        for text in ["", "SCAN.JBI", "A B", "ÄRGER", &"X".repeat(33)] {
            assert!(JobName::parse(text).is_err(), "{text}");
        }
    }
}
