//! Where a run stands, and which of the operator's words it takes there: the table of `docs/run.md`.

use serde::{Deserialize, Serialize};

/// What the operator wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Command {
    /// Stop the arm.
    Hold,
    /// Stop the arm where it stands once the frame of the view in work has come.
    HoldAfterView,
    /// Go on for one view, then hold; while the run goes on the same as [`Self::HoldAfterView`].
    Step,
    /// Go on after a hold.
    Resume,
    /// End the run.
    Abort,
    /// The stop key (Ctrl-C): hold; if the arm is held already, end the run.
    Stop,
}

/// Where a run stands. A hold that is to come after a view does not change it: that stands beside it
/// ([`Session::holds_after_view`](super::Session::holds_after_view)).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// The devices are asked who they are, set and switched on.
    Opening,
    /// The arm is on its way to a view.
    Moving,
    /// The arm stands at a view that is not triggered yet.
    AtTarget,
    /// The camera exposes; the arm must not move.
    Exposing,
    /// The arm stands and waits: for a frame, for room in the backlog, or for what becomes of the last views.
    Waiting,
    /// A hold is asked for and not confirmed.
    Holding,
    /// The arm is held and stands.
    Held,
    /// The hold is taken back and servo power switched on.
    Resuming,
    /// Both devices are being let go.
    Ending,
    /// Both devices have been let go.
    Over,
}

impl Command {
    /// Every word.
    pub const ALL: [Self; 6] = [
        Self::Hold,
        Self::HoldAfterView,
        Self::Step,
        Self::Resume,
        Self::Abort,
        Self::Stop,
    ];

    /// The word as recordings and documents write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hold => "hold",
            Self::HoldAfterView => "hold-after-view",
            Self::Step => "step",
            Self::Resume => "resume",
            Self::Abort => "abort",
            Self::Stop => "stop",
        }
    }
}

impl State {
    /// Every state, in the order of `docs/run.md`.
    pub const ALL: [Self; 10] = [
        Self::Opening,
        Self::Moving,
        Self::AtTarget,
        Self::Exposing,
        Self::Waiting,
        Self::Holding,
        Self::Held,
        Self::Resuming,
        Self::Ending,
        Self::Over,
    ];

    /// The state as documents write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Opening => "opening",
            Self::Moving => "moving",
            Self::AtTarget => "at-target",
            Self::Exposing => "exposing",
            Self::Waiting => "waiting",
            Self::Holding => "holding",
            Self::Held => "held",
            Self::Resuming => "resuming",
            Self::Ending => "ending",
            Self::Over => "over",
        }
    }

    /// Whether the operator's word does something here.
    pub fn accepts(self, command: Command) -> bool {
        use Command::{Abort, Hold, HoldAfterView, Resume, Step, Stop};
        match self {
            Self::Opening | Self::Moving | Self::AtTarget | Self::Exposing | Self::Waiting | Self::Resuming => {
                matches!(command, Hold | HoldAfterView | Step | Abort | Stop)
            }
            Self::Holding => matches!(command, Abort | Stop),
            Self::Held => matches!(command, Step | Resume | Abort | Stop),
            Self::Ending | Self::Over => false,
        }
    }

    /// Why a word is not accepted, and which would be.
    pub fn refusal(self, command: Command) -> String {
        let accepted: Vec<&str> = Command::ALL
            .into_iter()
            .filter(|command| self.accepts(*command))
            .map(Command::name)
            .collect();
        let accepted = match accepted.as_slice() {
            [] => "nothing".to_owned(),
            names => names.join(", "),
        };
        format!(
            "{} does nothing while {}; accepted now: {accepted}",
            command.name(),
            self.words()
        )
    }

    fn words(self) -> &'static str {
        match self {
            Self::Opening => "the devices are being made ready",
            Self::Moving => "the arm is on its way",
            Self::AtTarget => "the arm stands at a view",
            Self::Exposing => "the camera exposes",
            Self::Waiting => "the arm waits",
            Self::Holding => "the hold is not confirmed",
            Self::Held => "the arm is held",
            Self::Resuming => "the run is being resumed",
            Self::Ending => "the run is ending",
            Self::Over => "the last views are registered",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_lists_every_state_with_what_it_accepts() {
        let page = include_str!("../../docs/run.md");
        let table = page
            .split("| state | accepts |")
            .nth(1)
            .expect("the page has the table");
        let rows: Vec<(String, String)> = table
            .lines()
            .skip(2)
            .take_while(|line| line.starts_with('|'))
            .map(|line| {
                let cells: Vec<&str> = line.split('|').map(str::trim).collect();
                assert!(
                    cells.len() == 6 && cells[1..5].iter().all(|cell| !cell.is_empty()),
                    "{line}"
                );
                (cells[1].to_owned(), cells[2].to_owned())
            })
            .collect();
        let expected: Vec<(String, String)> = State::ALL
            .into_iter()
            .map(|state| {
                let names: Vec<&str> = Command::ALL
                    .into_iter()
                    .filter(|command| state.accepts(*command))
                    .map(Command::name)
                    .collect();
                let accepted = if names.is_empty() {
                    "nothing".into()
                } else {
                    names.join(", ")
                };
                (format!("`{}`", state.name()), accepted)
            })
            .collect();
        assert_eq!(rows, expected);
    }

    #[test]
    fn the_names_are_the_serialised_forms() {
        for state in State::ALL {
            assert_eq!(serde_json::to_string(&state).unwrap(), format!("\"{}\"", state.name()));
        }
        for command in Command::ALL {
            assert_eq!(
                serde_json::to_string(&command).unwrap(),
                format!("\"{}\"", command.name())
            );
        }
    }

    #[test]
    fn a_refused_word_is_answered_with_the_reason_and_what_would_be_accepted() {
        let refusal = State::Held.refusal(Command::Hold);
        assert_eq!(
            refusal,
            "hold does nothing while the arm is held; accepted now: step, resume, abort, stop"
        );
        assert!(State::Ending.refusal(Command::Abort).ends_with("accepted now: nothing"));
    }
}
