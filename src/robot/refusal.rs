//! Refusals in words: what was found, and what to do.

use super::reply::Refusal;

impl Refusal {
    /// What it means and what to do, in one line.
    pub fn words(self) -> String {
        match self.added_status {
            0x2010 => "the robot is moving (2010): wait until it stands".into(),
            0x2020 => "held at the pendant (2020): release the hold there".into(),
            0x2030 => "held at the panel (2030): release the hold there".into(),
            0x2040 => "held by an external signal (2040): release it".into(),
            0x2050 => "held by command (2050): resume the run".into(),
            0x2060 => "an error or alarm is present (2060): remove its cause and reset".into(),
            0x2070 => "servo power is off (2070): switch it on".into(),
            0x2080 => "wrong mode (2080): turn the mode key to PLAY/REMOTE".into(),
            0x2100 => "command remote is not set (2100): turn the key to REMOTE and set CMD REMOTE SEL (#82015)".into(),
            0x3450 => "servo power cannot be switched on (3450): release the emergency stop, close the doors".into(),
            0xB004 => "a value is out of range (B004): the pose lies outside the robot's workspace".into(),
            0xB009 | 0xB00A => "the speed is refused (B009/B00A): check the station's speeds".into(),
            0xB00D => "the tool number is refused (B00D): check the station's tool".into(),
            0xA000 => "the controller does not know this command (A000)".into(),
            0xD8F1 | 0xE444 | 0xD8FA | 0xFFF6 => format!("the controller is busy ({:04X})", self.added_status),
            0 => match self.status {
                0x08 => "the controller does not know this command (status 08)".into(),
                0x09 => "the controller does not know this attribute (status 09)".into(),
                0x28 => "the controller does not know this instance (status 28)".into(),
                status => format!("refused with status {status:02X} and no reason"),
            },
            added => format!("refused with {added:04X} (status {:02X})", self.status),
        }
    }
}
