//! What a run that ends by a fault leaves for those who look for its cause: `fault.json`.

use super::exchanges::Exchanges;
use super::{Input, Output};
use crate::event::{Ending, Event};
use crate::fault::Fault;
use crate::session::State;
use crate::stamp::Stamp;
use serde_json::{Value, json};

/// Watches a run: where in it we are, and what was exchanged last.
#[derive(Debug, Default)]
pub(super) struct Evidence {
    place: Place,
    exchanges: Exchanges,
    /// As everything was at the first fault.
    first: Option<Found>,
    /// Faults after the first.
    later: Vec<(Stamp, Fault)>,
}

#[derive(Debug)]
struct Found {
    at: Stamp,
    place: Place,
    exchanges: Exchanges,
}

/// Where in a run.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// The session's state when the input came that is being handled.
    state: State,
    /// The view that the arm went to last, and the attempt.
    view: Option<(usize, u16)>,
}

impl Default for Place {
    fn default() -> Self {
        Self {
            state: State::Opening,
            view: None,
        }
    }
}

impl Evidence {
    /// `state` is the session's as the input finds it.
    pub(super) fn note_input(&mut self, now: Stamp, input: &Input, state: State) {
        self.place.state = state;
        self.exchanges.note_input(now, input);
    }

    pub(super) fn note_output(&mut self, now: Stamp, output: &Output) {
        self.exchanges.note_output(now, output);
        match output {
            Output::Event(Event::Faulted { fault }) => self.note_fault(now, fault),
            Output::Event(Event::MoveStarted { view_index, attempt }) => {
                self.place.view = Some((*view_index, *attempt))
            }
            Output::Event(Event::Started { .. } | Event::Restarted { .. }) => self.place.view = None,
            _ => {}
        }
    }

    /// The content of `fault.json`, if the run ends by a fault. What was found is given away: a run that goes on after
    /// this begins to look anew.
    pub(super) fn take(&mut self, ending: &Ending, run: &Value) -> Option<Value> {
        let first = self.first.take();
        let later = std::mem::take(&mut self.later);
        let Ending::Faulted { fault } = ending else {
            return None;
        };
        let found = first?;
        let later: Vec<Value> = later
            .iter()
            .map(|(at, fault)| json!({ "at_s": at.seconds(), "code": fault.code, "seen": fault.seen }))
            .collect();
        Some(json!({
            "fault": fault,
            "at_s": found.at.seconds(),
            "state": found.place.state,
            "view_index": found.place.view.map(|(view_index, _)| view_index),
            "attempt": found.place.view.map(|(_, attempt)| attempt),
            "way_back": fault.code.way_back(),
            "remedy": fault.code.remedy(),
            "later_faults": later,
            "run": run,
            "exchanges": found.exchanges.value(),
        }))
    }

    fn note_fault(&mut self, now: Stamp, fault: &Fault) {
        if self.first.is_none() {
            self.first = Some(Found {
                at: now,
                place: self.place,
                exchanges: self.exchanges.clone(),
            });
        } else if self.later.len() < LATER_MAX {
            self.later.push((now, fault.clone()));
        }
    }
}

/// Faults after the first that are named.
const LATER_MAX: usize = 16;
