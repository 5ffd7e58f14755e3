//! Why the controller does not do what it is told: the added status of HSES, the error number of host control.

use core::fmt;

/// Refusal with its code. The codes are those of the vendor's own dissector; host control and HSES share them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Refused(pub u16);

/// Result of what the controller is asked to do.
pub type Answer<T> = Result<T, Refused>;

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}", self.0)
    }
}

#[allow(missing_docs, reason = "each name is the meaning of its code")]
impl Refused {
    pub const COMMAND: Self = Self(0x1010);
    pub const OPERAND_COUNT: Self = Self(0x1011);
    pub const OPERAND_RANGE: Self = Self(0x1012);
    pub const OPERAND_LENGTH: Self = Self(0x1013);
    pub const STORAGE_FULL: Self = Self(0x1020);
    pub const MOVING: Self = Self(0x2010);
    pub const HELD_BY_PENDANT: Self = Self(0x2020);
    pub const HELD_BY_PANEL: Self = Self(0x2030);
    pub const HELD_EXTERNALLY: Self = Self(0x2040);
    pub const HELD_BY_COMMAND: Self = Self(0x2050);
    pub const ALARM_PRESENT: Self = Self(0x2060);
    pub const SERVO_OFF: Self = Self(0x2070);
    pub const WRONG_MODE: Self = Self(0x2080);
    pub const FILE_IN_USE: Self = Self(0x2090);
    pub const NOT_REMOTE: Self = Self(0x2100);
    pub const JOB_IN_USE: Self = Self(0x2130);
    pub const SERVO_REFUSED: Self = Self(0x3450);
    pub const JOB_MEMORY: Self = Self(0x4010);
    pub const NO_SUCH_JOB: Self = Self(0x4040);
    pub const NO_JOB_SELECTED: Self = Self(0x4060);
    pub const POSITION_MISSING: Self = Self(0x4130);
    pub const INSTRUCTION_BROKEN: Self = Self(0x4170);
    pub const JOB_NAME: Self = Self(0x4190);
    pub const LABEL_NAME: Self = Self(0x4200);
    pub const INSTRUCTION_NOT_HERE: Self = Self(0x4230);
    pub const TEXT_SYNTAX: Self = Self(0x5110);
    pub const TEXT_POSITION: Self = Self(0x5120);
    pub const TEXT_NOP_END: Self = Self(0x5130);
    pub const TEXT_FORMAT: Self = Self(0x5170);
    pub const TEXT_NUMBER_COUNT: Self = Self(0x5180);
    pub const TEXT_RANGE: Self = Self(0x5200);
    pub const TEXT_PSEUDO_INSTRUCTION: Self = Self(0x5340);
    pub const NO_COMMAND: Self = Self(0xA000);
    pub const NO_INSTANCE: Self = Self(0xA001);
    pub const NO_ATTRIBUTE: Self = Self(0xA002);
    pub const POSITION_UNDEFINED: Self = Self(0xB001);
    pub const USE_FORBIDDEN: Self = Self(0xB002);
    pub const DATA_SIZE: Self = Self(0xB003);
    pub const VALUE: Self = Self(0xB004);
    pub const POSITION_TYPE: Self = Self(0xB007);
    pub const GROUP: Self = Self(0xB008);
    pub const SPEED: Self = Self(0xB009);
    pub const SPEED_MISSING: Self = Self(0xB00A);
    pub const COORDINATE: Self = Self(0xB00B);
    pub const FORM: Self = Self(0xB00C);
    pub const TOOL: Self = Self(0xB00D);
    pub const USER_FRAME: Self = Self(0xB00E);
    pub const BUSY: Self = Self(0xE444);
    pub const FILE_STALLED: Self = Self(0xE28B);
    pub const FILE_NOT_OVERWRITTEN: Self = Self(0xE28C);
    pub const FILE_EMPTY: Self = Self(0xE29C);
    pub const FILE_PATH: Self = Self(0xE2A0);
    pub const FILE_KEPT: Self = Self(0xE2AF);
    pub const FILE_NOT_REMOTE: Self = Self(0xE2B2);
    pub const FILE_NOT_FOUND: Self = Self(0xE2B3);
    pub const FILE_PATH_LONG: Self = Self(0xE2B4);
}
