//! Progress for the person at the terminal: bars where there is one, plain lines elsewhere.

use crate::controller::Output;
use crate::event::{Ending, Event};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use std::io::{IsTerminal as _, Write as _};
use std::time::Duration;

/// Shows events on standard error.
pub struct Console {
    bars: Option<Bars>,
    quiet: bool,
}

/// Says something to the person, from any thread.
#[derive(Clone)]
pub struct Voice(Option<MultiProgress>);

impl Voice {
    /// Says it.
    pub fn say(&self, text: &str) {
        match &self.0 {
            Some(bars) => {
                bars.println(text).ok();
            }
            None => line(text),
        }
    }
}

struct Bars {
    all: MultiProgress,
    run: ProgressBar,
    view: ProgressBar,
}

impl Console {
    /// Bars on a terminal, lines elsewhere.
    pub fn new() -> Self {
        let bars = std::io::stderr().is_terminal().then(Bars::new);
        Self { bars, quiet: false }
    }

    /// Shows nothing but faults.
    pub fn quiet() -> Self {
        Self {
            bars: None,
            quiet: true,
        }
    }

    /// Shows one event.
    pub fn show(&mut self, event: &Event) {
        let important = matches!(event, Event::Faulted { .. });
        match (&self.bars, self.quiet) {
            (Some(bars), _) => bars.show(event),
            (None, true) if !important => {}
            (None, _) if is_worth_a_line(event) || important => line(&event.words()),
            (None, _) => {}
        }
        if let Event::Faulted { fault } = event {
            self.say(&format!("  Do: {}", fault.code.remedy()));
            self.say(&format!("  Back: {}", fault.code.way_back().words()));
        }
        if matches!(event, Event::Held) {
            self.say("HELD. With Enter, r: resume   s: one view, then held again   a: abort   Ctrl-C: abort");
        }
    }

    /// Shows on the bar, without a word, what happened before the run goes on.
    pub fn show_past(&mut self, output: &Output) {
        if let (Some(bars), Output::Event(event)) = (&self.bars, output) {
            bars.show_past(event);
        }
    }

    /// Says what begins: work on this many views.
    pub fn begin(&self, text: &str, view_count: usize) {
        self.say(text);
        if let Some(bars) = &self.bars {
            bars.run.set_length(view_count as u64);
        }
    }

    /// Says something to the person.
    pub fn say(&self, text: &str) {
        self.voice().say(text);
    }

    /// A voice for another thread, which does not tear the bars.
    pub fn voice(&self) -> Voice {
        Voice(self.bars.as_ref().map(|bars| bars.all.clone()))
    }

    /// Takes the bars away.
    pub fn close(&mut self) {
        if let Some(bars) = self.bars.take() {
            bars.run.finish_and_clear();
            bars.view.finish_and_clear();
        }
    }
}

impl Default for Console {
    fn default() -> Self {
        Self::new()
    }
}

impl Bars {
    fn new() -> Self {
        let all = MultiProgress::new();
        let run = all.add(ProgressBar::new(0));
        run.set_style(style("run  [{bar:36}] {pos}/{len} views decided, {msg}"));
        run.set_message("starting");
        let view = all.add(ProgressBar::new(VIEW_STEPS));
        view.set_style(style("view [{bar:36}] {msg}"));
        run.enable_steady_tick(Duration::from_millis(200));
        Self { all, run, view }
    }

    fn show(&self, event: &Event) {
        match event {
            Event::Started { view_count, .. } => self.run.set_length(*view_count as u64),
            Event::MoveStarted { .. } => self.step(1, event),
            Event::Arrived { .. } => self.step(2, event),
            Event::Triggered { .. } => self.step(3, event),
            Event::ExposureDone { .. } => self.step(4, event),
            Event::FrameArrived { .. } => self.step(5, event),
            Event::ViewPrepared { .. } => {}
            Event::ViewMerged { model_point_count, .. } => {
                self.run.inc(1);
                self.run.set_message(format!("model {model_point_count} points"));
                self.print(event);
            }
            Event::ViewDiscarded { .. } | Event::ViewMissing { .. } => {
                self.run.inc(1);
                self.print(event);
            }
            Event::ViewTakenAgain { .. } => {
                self.run.dec(1);
                self.print(event);
            }
            event if is_worth_a_line(event) => self.print(event),
            _ => {}
        }
    }

    fn show_past(&self, event: &Event) {
        match event {
            Event::Started { view_count, .. } => {
                self.run.set_length(*view_count as u64);
                self.run.set_message("going through the recording");
            }
            Event::ViewMerged { .. } | Event::ViewDiscarded { .. } | Event::ViewMissing { .. } => self.run.inc(1),
            _ => {}
        }
    }

    fn step(&self, done: u64, event: &Event) {
        self.view.set_position(done);
        self.view.set_message(event.words());
    }

    fn print(&self, event: &Event) {
        self.all.println(event.words()).ok();
    }
}

fn is_worth_a_line(event: &Event) -> bool {
    match event {
        Event::Started { .. }
        | Event::RobotIdentified { .. }
        | Event::CameraReady { .. }
        | Event::FrameFailed { .. }
        | Event::CameraAway { .. }
        | Event::CameraBack { .. }
        | Event::CameraWaiting { .. }
        | Event::CameraRearmed
        | Event::ViewMerged { .. }
        | Event::ViewDiscarded { .. }
        | Event::ViewTakenAgain { .. }
        | Event::ViewMissing { .. }
        | Event::HoldDeferred { .. }
        | Event::HoldAsked { .. }
        | Event::Held
        | Event::Resumed
        | Event::Restarted { .. }
        | Event::GripChecked { .. }
        | Event::AbortAsked
        | Event::Faulted { .. }
        | Event::Noted { .. } => true,
        Event::Ended { ending } => !matches!(ending, Ending::Faulted { .. }),
        _ => false,
    }
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template)
        .expect("the templates are fixed and tested")
        .progress_chars("=> ")
}

fn line(text: &str) {
    // A closed standard error is no reason to stop a run.
    writeln!(std::io::stderr(), "{text}").ok();
}

const VIEW_STEPS: u64 = 5;

#[cfg(test)]
mod tests {
    #[test]
    fn the_templates_are_valid() {
        super::Bars::new();
    }
}
