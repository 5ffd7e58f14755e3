//! Alarms: up to four active ones, and what was there before.

/// An alarm of the controller. Code 0 is never raised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Alarm {
    /// Number, for example 4315.
    pub code: u32,
    /// Sub-code.
    pub data: u32,
    /// When it was raised, ns of the cell's clock.
    pub raised_ns: u64,
}

/// List of the history that an alarm goes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AlarmGroup {
    /// Instances 1 to 100.
    Major,
    /// Instances 1001 to 1100.
    Minor,
    /// Instances 2001 to 2100.
    UserSystem,
    /// Instances 3001 to 3100.
    UserUser,
    /// Instances 4001 to 4100.
    Offline,
}

impl Alarm {
    /// Whether it cannot be reset but by switching the controller off and on.
    pub fn is_major(&self) -> bool {
        self.code < MINOR_CODE_MIN
    }

    /// Name as the pendant would show it, at most 32 bytes of ASCII.
    pub fn name(&self) -> &'static str {
        match self.code {
            CODE_COLLISION => "COLLISION DETECT",
            CODE_ESTOP => "SIMULATED EMERGENCY STOP",
            CODE_INSTRUCTION => "SIMULATED BAD INSTRUCTION",
            CODE_POSITION => "SIMULATED UNDEFINED POSITION",
            CODE_LIMIT => "SIMULATED SOFT LIMIT",
            _ => "SIMULATED ALARM",
        }
    }

    /// "YYYY/MM/DD HH:MM" of a calendar that begins when the cell does.
    pub fn time(&self) -> String {
        controller_time(self.raised_ns)
    }
}

/// Active alarms and their history.
#[derive(Clone, Debug, Default)]
pub struct AlarmBook {
    /// Newest first.
    active: Vec<Alarm>,
    /// Newest first.
    major: Vec<Alarm>,
    /// Newest first.
    minor: Vec<Alarm>,
}

impl AlarmBook {
    /// Enters an alarm as the newest.
    pub fn raise(&mut self, alarm: Alarm) {
        let history = if alarm.is_major() {
            &mut self.major
        } else {
            &mut self.minor
        };
        history.insert(0, alarm);
        history.truncate(HISTORY_COUNT_MAX);
        self.active.insert(0, alarm);
        self.active.truncate(ACTIVE_COUNT_MAX);
    }

    /// Clears every active alarm that may be reset; `keep` are the codes whose cause is still there.
    pub fn reset(&mut self, keep: &[u32]) {
        self.active
            .retain(|alarm| alarm.is_major() || keep.contains(&alarm.code));
    }

    /// Clears every active alarm, as switching off and on does.
    pub fn clear(&mut self) {
        self.active.clear();
    }

    /// Whether any alarm is active.
    pub fn is_any(&self) -> bool {
        !self.active.is_empty()
    }

    /// Active alarm; 0 is the newest.
    pub fn active(&self, index: usize) -> Option<Alarm> {
        self.active.get(index).copied()
    }

    /// Alarm of the history; 0 is the newest. Only the first two groups ever have any.
    pub fn history(&self, group: AlarmGroup, index: usize) -> Option<Alarm> {
        match group {
            AlarmGroup::Major => self.major.get(index).copied(),
            AlarmGroup::Minor => self.minor.get(index).copied(),
            AlarmGroup::UserSystem | AlarmGroup::UserUser | AlarmGroup::Offline => None,
        }
    }
}

/// "YYYY/MM/DD HH:MM" of a calendar that begins when the cell does.
pub fn controller_time(now_ns: u64) -> String {
    let minutes = 3 * 60 + 4 + now_ns / 60_000_000_000;
    format!(
        "2026/01/{:02} {:02}:{:02}",
        (2 + minutes / 1440).min(31),
        minutes / 60 % 24,
        minutes % 60
    )
}

/// Active alarms that can be asked for.
pub const ACTIVE_COUNT_MAX: usize = 4;
/// Alarms that each list of the history keeps.
pub const HISTORY_COUNT_MAX: usize = 100;
/// Alarm of the vectors on the protocol page.
pub const CODE_COLLISION: u32 = 4315;
/// A job's instruction cannot be carried out; the sub-code is the line. The simulator's own choice of number.
pub const CODE_INSTRUCTION: u32 = 4170;
/// A move of a job has no position; the sub-code is the line. The simulator's own choice of number.
pub const CODE_POSITION: u32 = 4130;
/// A move of a job leads out of the workspace; the sub-code is the line. The simulator's own choice of number.
pub const CODE_LIMIT: u32 = 4416;
/// What an emergency stop leaves behind. The simulator's own choice of number.
pub const CODE_ESTOP: u32 = 9001;
/// Below this an alarm is major. The simulator's own choice: no source states the limit.
const MINOR_CODE_MIN: u32 = 4000;

#[cfg(test)]
mod tests {
    use super::*;

    fn alarm(code: u32, raised_ns: u64) -> Alarm {
        Alarm {
            code,
            data: 0,
            raised_ns,
        }
    }

    #[test]
    fn the_newest_four_are_active_and_the_history_keeps_a_hundred() {
        let mut book = AlarmBook::default();
        for at in 0..200 {
            book.raise(alarm(4315, at));
        }
        let newest: Vec<_> = (0..5)
            .map(|index| book.active(index).map(|alarm| alarm.raised_ns))
            .collect();
        assert_eq!(newest, [Some(199), Some(198), Some(197), Some(196), None]);
        assert_eq!(book.history(AlarmGroup::Minor, 99), Some(alarm(4315, 100)));
        assert_eq!(book.history(AlarmGroup::Minor, 100), None);
        assert_eq!(book.history(AlarmGroup::Major, 0), None);
    }

    #[test]
    fn a_reset_leaves_major_alarms_and_those_whose_cause_is_there() {
        let mut book = AlarmBook::default();
        for code in [1325, CODE_ESTOP, CODE_COLLISION] {
            book.raise(alarm(code, 0));
        }
        book.reset(&[CODE_ESTOP]);
        assert_eq!(book.active(0).map(|alarm| alarm.code), Some(CODE_ESTOP));
        assert_eq!(book.active(1).map(|alarm| alarm.code), Some(1325));
        book.reset(&[]);
        assert_eq!(book.active(0).map(|alarm| alarm.code), Some(1325));
        book.clear();
        assert!(!book.is_any());
        assert_eq!(book.history(AlarmGroup::Major, 0), Some(alarm(1325, 0)));
    }
}
