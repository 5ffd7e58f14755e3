//! The operator's words, and the hold: at once, or after the view in work.

use super::{Command, Hold, Session, Stage, State, Target};
use crate::event::{Ending, Event, HoldBy};
use crate::stamp::Stamp;

/// A hold that is to come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HoldAfter {
    /// After the view that the run goes on with; which one is not known yet.
    Next,
    /// After this view has been taken or given up.
    View(usize),
}

impl Session {
    /// Where the acquisition stands.
    pub fn state(&self) -> State {
        match (&self.ending, self.hold, self.stage) {
            (Some(_), _, _) if self.is_over() => State::Over,
            (Some(_), _, _) => State::Ending,
            (None, Hold::Asked, _) => State::Holding,
            (None, Hold::Held, _) => State::Held,
            (None, Hold::Resuming, _) => State::Resuming,
            (None, Hold::No, Stage::Opening) => State::Opening,
            (None, Hold::No, Stage::ToTarget) => State::Waiting,
            (None, Hold::No, Stage::Moving(_)) => State::Moving,
            (None, Hold::No, Stage::AtTarget(_)) => State::AtTarget,
            (None, Hold::No, Stage::Exposing(_)) => State::Exposing,
        }
    }

    /// Whether the arm will be held after a view without another word of the operator.
    pub fn holds_after_view(&self) -> bool {
        self.hold_after.is_some()
    }

    /// Does what the operator wants, or notes why it cannot be.
    pub fn obey(&mut self, now: Stamp, command: Command) {
        let state = self.state();
        if !state.accepts(command) {
            return self.note(state.refusal(command));
        }
        let held = matches!(state, State::Holding | State::Held);
        match command {
            Command::Stop if held => self.abort(now),
            Command::Hold | Command::Stop => self.hold(now, HoldBy::Operator),
            Command::Step if held => {
                self.hold_after = Some(HoldAfter::Next);
                self.resume(now);
            }
            Command::HoldAfterView | Command::Step => self.hold_after_view(now),
            Command::Resume => self.resume(now),
            Command::Abort => self.abort(now),
        }
    }

    /// Holds the arm at once.
    pub(super) fn hold(&mut self, now: Stamp, by: HoldBy) {
        if self.ending.is_some() || !matches!(self.hold, Hold::No | Hold::Resuming) {
            return;
        }
        self.hold_after = None;
        self.emit(Event::HoldAsked { by });
        self.hold = Hold::Asked;
        self.interrupt();
        self.arm.hold(now);
    }

    /// Holds the arm when the deferred hold falls due.
    pub(super) fn hold_if_due(&mut self, now: Stamp) {
        match self.hold_after {
            Some(HoldAfter::Next) => {
                if let Some(&Target { view_index, .. }) = self.targets.front() {
                    self.defer_hold(view_index);
                }
            }
            // After the last view the run ends instead, unless some are taken again.
            Some(HoldAfter::View(view_index)) if !self.is_open(view_index) && !self.is_acquired() => {
                self.hold(now, HoldBy::Operator);
            }
            Some(HoldAfter::View(_)) | None => {}
        }
    }

    /// Whether the arm may leave for the next target: with a deferred hold only while its view is still to be exposed.
    pub(super) fn may_go_on(&self) -> bool {
        match self.hold_after {
            Some(HoldAfter::View(view_index)) => self.is_to_be_exposed(view_index),
            Some(HoldAfter::Next) | None => true,
        }
    }

    /// Defers the hold to the end of the view in work. Between two views there is nothing to wait for.
    fn hold_after_view(&mut self, now: Stamp) {
        let in_work = match self.stage {
            Stage::Moving(target) => Some(target),
            Stage::AtTarget(standing) | Stage::Exposing(standing) => Some(standing.target),
            Stage::ToTarget => self.awaited.map(|standing| standing.target),
            Stage::Opening => None,
        };
        match in_work {
            Some(target) => self.defer_hold(target.view_index),
            None if self.hold == Hold::Resuming || matches!(self.stage, Stage::Opening) => {
                self.hold_after = Some(HoldAfter::Next);
            }
            None => self.hold(now, HoldBy::Operator),
        }
    }

    fn defer_hold(&mut self, view_index: usize) {
        let hold_after = Some(HoldAfter::View(view_index));
        if self.hold_after != hold_after {
            self.hold_after = hold_after;
            self.emit(Event::HoldDeferred { view_index });
        }
    }

    /// Whether a frame of the view is still to come.
    fn is_open(&self, view_index: usize) -> bool {
        let is_awaited = self
            .awaited
            .is_some_and(|standing| standing.target.view_index == view_index);
        is_awaited || self.is_to_be_exposed(view_index)
    }

    fn is_to_be_exposed(&self, view_index: usize) -> bool {
        self.targets.iter().any(|target| target.view_index == view_index)
    }

    fn resume(&mut self, now: Stamp) {
        self.hold = Hold::Resuming;
        if self.robot_known && self.camera_known {
            self.arm.make_ready(now);
        } else {
            self.hold = Hold::No;
            self.emit(Event::Resumed);
            self.arm.identify(now);
        }
    }

    fn abort(&mut self, now: Stamp) {
        self.emit(Event::AbortAsked);
        self.end(now, Ending::Aborted);
    }
}
