//! What a client reads and writes in the controller's memory: variables, registers, signals.

use crate::checks::refuse_first;
use crate::robot::controller::Controller;
use crate::robot::refused::{Answer, Refused};
use crate::robot::variables::{Kind, Value};

impl Controller {
    /// Value of a variable; A001 for one that does not exist, B001 for a position that was never set.
    pub fn variable(&mut self, now_ns: u64, kind: Kind, index: u16) -> Answer<Value> {
        self.advance(now_ns);
        self.variables.read(kind, index)
    }

    /// Sets a variable.
    pub fn set_variable(&mut self, now_ns: u64, index: u16, value: Value) -> Answer<()> {
        self.advance(now_ns);
        self.check_can_write()?;
        self.variables.write(index, value)
    }

    /// Register, 0 to 999.
    pub fn register(&mut self, now_ns: u64, index: u16) -> Answer<u16> {
        self.advance(now_ns);
        self.variables.register(index)
    }

    /// Sets a register, 0 to 559.
    pub fn set_register(&mut self, now_ns: u64, index: u16, value: u16) -> Answer<()> {
        self.advance(now_ns);
        self.check_can_write()?;
        self.variables.set_register(index, value)
    }

    /// Eight signals by the number of their byte (that of the signals without its last digit); A001 outside every area.
    pub fn signal_byte(&mut self, now_ns: u64, byte: u16) -> Answer<u8> {
        self.advance(now_ns);
        self.signals.byte(byte)
    }

    /// Sets eight network inputs; B002 for other signals, A001 outside every area.
    pub fn set_signal_byte(&mut self, now_ns: u64, byte: u16, value: u8) -> Answer<()> {
        self.advance(now_ns);
        self.check_can_write()?;
        self.signals.write_network(byte, value)
    }

    /// Refuses what writes to memory while that needs command remote and it is not set.
    pub fn check_can_write(&self) -> Answer<()> {
        let is_barred = self.settings.options.writes_need_remote && !self.switches.is_command_remote();
        refuse_first([(is_barred, Refused::NOT_REMOTE)])
    }
}
