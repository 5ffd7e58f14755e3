//! What a run that ends by a fault leaves for those who look for its cause: `fault.json`.

use super::exchanges::Exchanges;
use super::{Input, Output};
use crate::event::{Ending, Event};
use crate::fault::Fault;
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
#[derive(Debug, Clone, Copy, Default)]
struct Place {
    state: Option<&'static str>,
    view: Option<(usize, u16)>,
}

impl Evidence {
    pub(super) fn note_input(&mut self, now: Stamp, input: &Input) {
        self.exchanges.note_input(now, input);
    }

    pub(super) fn note_output(&mut self, now: Stamp, output: &Output) {
        self.exchanges.note_output(now, output);
        match output {
            Output::Event(Event::Faulted { fault }) => self.note_fault(now, fault),
            Output::Event(event) => self.place.follow(event),
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
            "state": found.place.state.unwrap_or("opening"),
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

impl Place {
    fn follow(&mut self, event: &Event) {
        let (state, view) = match event {
            Event::Started { .. } | Event::Restarted { .. } => ("opening", None),
            Event::RobotReady | Event::Resumed => ("ready", self.view),
            Event::MoveStarted { view_index, attempt } => ("moving", Some((*view_index, *attempt))),
            Event::Arrived { view_index, attempt } => ("standing", Some((*view_index, *attempt))),
            Event::Triggered { view_index, attempt } => ("exposing", Some((*view_index, *attempt))),
            Event::ExposureDone {
                view_index, attempt, ..
            } => ("exposed", Some((*view_index, *attempt))),
            Event::HoldAsked { .. } => ("holding", self.view),
            Event::Held => ("held", self.view),
            _ => return,
        };
        *self = Self {
            state: Some(state),
            view,
        };
    }
}

/// Faults after the first that are named.
const LATER_MAX: usize = 16;
