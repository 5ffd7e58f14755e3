//! The controller's signals, eight to a byte. A byte's number is that of its signals without the last digit.

use crate::robot::refused::{Answer, Refused};

/// An area of signals: first and last number of its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Area {
    /// First byte.
    pub first: u16,
    /// Last byte.
    pub last: u16,
}

/// All signals. A real controller's ladder program joins them; this one's copies external and network inputs to the
/// general inputs of the same place, and general outputs to external and network outputs.
#[derive(Clone, Debug)]
pub struct Signals {
    /// One a number, areas in the order of [`AREAS`].
    bytes: Vec<u8>,
}

impl Default for Signals {
    fn default() -> Self {
        Self {
            bytes: vec![0; AREAS.iter().map(|area| area.count()).sum()],
        }
    }
}

impl Area {
    fn count(self) -> usize {
        usize::from(self.last - self.first) + 1
    }

    fn contains(self, byte: u16) -> bool {
        (self.first..=self.last).contains(&byte)
    }
}

impl Signals {
    /// Byte of signals; A001 outside every area.
    pub fn byte(&self, byte: u16) -> Answer<u8> {
        let own = self.stored(byte)?;
        let also = |first: u16, area: Area| {
            let other = area.first + (byte - first);
            if area.contains(other) {
                self.stored(other).unwrap_or(0)
            } else {
                0
            }
        };
        Ok(match byte {
            _ if GENERAL_IN.contains(byte) => {
                own | also(GENERAL_IN.first, EXTERNAL_IN) | also(GENERAL_IN.first, NETWORK_IN)
            }
            _ if EXTERNAL_OUT.contains(byte) => also(EXTERNAL_OUT.first, GENERAL_OUT),
            _ if NETWORK_OUT.contains(byte) => also(NETWORK_OUT.first, GENERAL_OUT),
            _ => own,
        })
    }

    /// Sets a byte from outside: network inputs only, B002 for others, A001 outside every area.
    pub fn write_network(&mut self, byte: u16, value: u8) -> Answer<()> {
        if !NETWORK_IN.contains(byte) {
            self.stored(byte)?;
            return Err(Refused::USE_FORBIDDEN);
        }
        self.set_byte(byte, value)
    }

    /// Sets a byte from inside, or as a wire at an input does.
    pub fn set_byte(&mut self, byte: u16, value: u8) -> Answer<()> {
        let at = place(byte).ok_or(Refused::NO_INSTANCE)?;
        self.bytes[at] = value;
        Ok(())
    }

    /// Signal by its number, whose last digit is 0 to 7.
    pub fn signal(&self, signal: u32) -> Answer<bool> {
        let (byte, bit) = split(signal)?;
        Ok(self.byte(byte)? >> bit & 1 == 1)
    }

    /// Sets a signal by its number, from inside or as a wire does.
    pub fn set_signal(&mut self, signal: u32, is_on: bool) -> Answer<()> {
        let (byte, bit) = split(signal)?;
        let value = self.stored(byte)?;
        self.set_byte(byte, value & !(1 << bit) | u8::from(is_on) << bit)
    }

    /// General input or output by INFORM's number, 1 to 4096: 1 is the first signal of the first byte.
    pub fn inform_signal(area: Area, number: u16) -> Option<u32> {
        let byte = number.checked_sub(1)? / 8;
        (usize::from(byte) < area.count()).then(|| u32::from(area.first + byte) * 10 + u32::from((number - 1) % 8))
    }

    fn stored(&self, byte: u16) -> Answer<u8> {
        place(byte).map(|at| self.bytes[at]).ok_or(Refused::NO_INSTANCE)
    }
}

fn split(signal: u32) -> Answer<(u16, u32)> {
    let (byte, bit) = (u16::try_from(signal / 10), signal % 10);
    match byte {
        Ok(byte) if bit < 8 => Ok((byte, bit)),
        _ => Err(Refused::NO_INSTANCE),
    }
}

/// Place of a byte among all of them.
fn place(byte: u16) -> Option<usize> {
    let mut before = 0;
    for area in AREAS {
        if area.contains(byte) {
            return Some(before + usize::from(byte - area.first));
        }
        before += area.count();
    }
    None
}

const fn area(first: u16, last: u16) -> Area {
    Area { first, last }
}

/// Inputs that jobs read.
pub const GENERAL_IN: Area = area(1, 512);
/// Outputs that jobs set.
pub const GENERAL_OUT: Area = area(1001, 1512);
/// Inputs from the cell's wires.
pub const EXTERNAL_IN: Area = area(2001, 2512);
/// Inputs that clients set; the only ones.
pub const NETWORK_IN: Area = area(2701, 2956);
/// Outputs to the cell's wires.
pub const EXTERNAL_OUT: Area = area(3001, 3512);
/// Outputs that clients read.
pub const NETWORK_OUT: Area = area(3701, 3956);
/// All areas in ascending order. The sources give different ends; these are of the client that names the DX generation.
pub const AREAS: [Area; 11] = [
    GENERAL_IN,
    GENERAL_OUT,
    EXTERNAL_IN,
    NETWORK_IN,
    EXTERNAL_OUT,
    NETWORK_OUT,
    area(4001, 4160),
    area(5001, 5300),
    area(6001, 6064),
    area(7001, 7999),
    area(8001, 8128),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_area_has_its_ends_and_nothing_between_them() {
        let signals = Signals::default();
        for area in AREAS {
            assert_eq!(signals.byte(area.first), Ok(0));
            assert_eq!(signals.byte(area.last), Ok(0));
            assert_eq!(signals.byte(area.first - 1), Err(Refused::NO_INSTANCE));
            assert_eq!(signals.byte(area.last + 1), Err(Refused::NO_INSTANCE));
        }
    }

    #[test]
    fn only_network_inputs_are_written_and_jobs_see_them() {
        let mut signals = Signals::default();
        assert_eq!(signals.write_network(2702, 0x81), Ok(()));
        assert_eq!(signals.byte(2), Ok(0x81));
        assert_eq!(signals.signal(27), Ok(true));
        assert_eq!(signals.signal(26), Ok(false));
        assert_eq!(signals.write_network(1, 1), Err(Refused::USE_FORBIDDEN));
        assert_eq!(signals.write_network(2957, 1), Err(Refused::NO_INSTANCE));
        assert_eq!(signals.signal(28), Err(Refused::NO_INSTANCE));
    }

    #[test]
    fn a_general_output_is_seen_on_wires_and_network() {
        let mut signals = Signals::default();
        let signal = Signals::inform_signal(GENERAL_OUT, 10).unwrap();
        assert_eq!(signal, 10_021);
        signals.set_signal(signal, true).unwrap();
        assert_eq!(signals.byte(1002), Ok(2));
        assert_eq!(signals.byte(3002), Ok(2));
        assert_eq!(signals.byte(3702), Ok(2));
        assert_eq!(Signals::inform_signal(GENERAL_OUT, 0), None);
        assert_eq!(Signals::inform_signal(GENERAL_OUT, 4097), None);
    }
}
