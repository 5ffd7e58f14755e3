//! Refusals in words: what was found, and what to do.

mod codes;

use super::reply::Refusal;
use codes::{CODES, STATUSES};

impl Refusal {
    /// What it means and what to do, in one line.
    pub fn words(self) -> String {
        let Self { status, added_status } = self;
        if let Ok(at) = CODES.binary_search_by_key(&added_status, |(code, ..)| *code) {
            let (_, found, remedy) = CODES[at];
            return format!("{found} ({added_status:04X}): {remedy}");
        }
        if added_status != 0 {
            return format!(
                "refused with {added_status:04X} (status {status:02X}): look it up in the controller's manual"
            );
        }
        match STATUSES.iter().find(|(code, ..)| *code == status) {
            Some((_, found, remedy)) => format!("{found} (status {status:02X}): {remedy}"),
            None => format!("refused with status {status:02X} and no reason: look at the pendant"),
        }
    }

    /// Whether the controller may say yes to the same words a little later.
    pub fn is_busy(self) -> bool {
        matches!(self.added_status, 0xD8F1 | 0xD8FA | 0xE444 | 0xFFF6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(status: u8, added_status: u16) -> String {
        Refusal { status, added_status }.words()
    }

    #[test]
    fn codes_are_in_order_and_stand_once() {
        assert!(CODES.is_sorted_by(|(a, ..), (b, ..)| a < b));
    }

    #[test]
    fn every_code_has_one_line_with_cause_and_remedy() {
        for (code, found, remedy) in CODES {
            let line = words(0x1F, *code);
            assert!(!found.is_empty() && !remedy.is_empty(), "{code:04X}");
            assert!(
                line.len() <= 160 && !line.contains('\n') && !line.ends_with('.'),
                "{line}"
            );
            assert!(line.contains(&format!("{code:04X}")), "{line}");
        }
    }

    #[test]
    fn both_forms_of_an_unknown_command_say_the_same() {
        for (status, added) in [(0x08, 0xA000), (0x28, 0xA001), (0x09, 0xA002)] {
            let (short, long) = (words(status, 0), words(0x1F, added));
            assert_eq!(
                short.replace(&format!("status {status:02X}"), &format!("{added:04X}")),
                long
            );
        }
    }

    #[test]
    fn a_code_that_nobody_knows_is_told_as_it_came() {
        assert!(words(0x1F, 0x7777).contains("7777"));
        assert!(words(0x42, 0).contains("42"));
    }

    #[test]
    fn a_busy_controller_is_told_apart() {
        let busy = |added_status| {
            Refusal {
                status: 0x1F,
                added_status,
            }
            .is_busy()
        };
        assert!(busy(0xE444) && !busy(0x2010));
    }
}
