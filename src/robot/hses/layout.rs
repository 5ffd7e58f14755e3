//! How values stand in frames: command numbers, widths, and how many one frame carries (`docs/protocols/hses.md`, section 10).

use crate::robot::variable::VariableKind;

/// One kind of value on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    /// The command for a single value.
    pub one: u16,
    /// The command for several in a row.
    pub many: u16,
    /// Bytes of one value.
    pub bytes: usize,
    /// The most values one frame carries.
    pub count_max: u16,
    /// Whether several go in even numbers only.
    pub even: bool,
}

/// The layout of variables and registers.
pub(super) fn layout(kind: VariableKind) -> Layout {
    match kind {
        VariableKind::Byte => Layout::new(0x7A, 0x302, 1, 474).even(),
        VariableKind::Integer => Layout::new(0x7B, 0x303, 2, 237),
        VariableKind::Double => Layout::new(0x7C, 0x304, 4, 118),
        VariableKind::Real => Layout::new(0x7D, 0x305, 4, 118),
        VariableKind::Text => Layout::new(0x7E, 0x306, TEXT_BYTES, 29),
        VariableKind::Position => Layout::new(0x7F, 0x307, 52, 9),
        VariableKind::Register => Layout::new(0x79, 0x301, 2, 237),
    }
}

/// The layout of groups of eight signals.
pub(super) const SIGNALS: Layout = Layout::new(0x78, 0x300, 1, 474).even();

/// Bytes of an S variable.
pub(super) const TEXT_BYTES: usize = 16;

/// Types of positions, in positions and in moves.
pub(super) const BASE: i32 = 16;
pub(super) const ROBOT: i32 = 17;
pub(super) const USER: i32 = 18;
pub(super) const TOOL: i32 = 19;

impl Layout {
    const fn new(one: u16, many: u16, bytes: usize, count_max: u16) -> Self {
        Self {
            one,
            many,
            bytes,
            count_max,
            even: false,
        }
    }

    const fn even(self) -> Self {
        Self { even: true, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::hses::DATA_BYTES_MAX;

    #[test]
    fn the_most_values_of_every_kind_fit_a_frame() {
        for kind in [
            VariableKind::Byte,
            VariableKind::Integer,
            VariableKind::Double,
            VariableKind::Real,
            VariableKind::Text,
            VariableKind::Position,
            VariableKind::Register,
        ] {
            let Layout {
                bytes, count_max, even, ..
            } = layout(kind);
            assert!(4 + bytes * usize::from(count_max) <= DATA_BYTES_MAX, "{kind:?}");
            assert!(!even || count_max % 2 == 0, "{kind:?}");
        }
    }
}
