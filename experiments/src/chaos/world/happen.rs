//! What happens to a run, who puts it right, and what it explains.

use std::collections::BTreeSet;

use bladescan::controller::{Command, Input};
use bladescan::event::Ending;
use hw_sim::cell;
use hw_sim::fault::Fault;
use hw_sim::robot::controller::Panel;

use super::super::disk::Times;
use super::super::draw::{Happening, Kind};
use super::super::judge::Bar;
use super::{Delivery, Met, Process, Sudden, World};
use crate::camera_faults::setup::row;

impl World<'_> {
    /// A thing happens.
    pub(super) fn befall(&mut self, process: &mut Process, happening: Happening) {
        let Happening {
            kind, span_ns, size, ..
        } = happening;
        self.tell(|| format!("HAPPENS: {} ({:.3} s, {size:.3})", kind.name(), span_ns as f64 * 1e-9));
        let mut until_ns = self.now_ns + span_ns;
        match kind {
            Kind::Alarm => self.at_panel(Panel::Alarm(ALARM_CODE), span_ns, &[Panel::Reset]),
            Kind::EmergencyStop => {
                let released = [Panel::EmergencyStop(false), Panel::Reset];
                self.at_panel(Panel::EmergencyStop(true), span_ns, &released);
            }
            Kind::Door => self.at_panel(Panel::Door(true), span_ns, &[Panel::Door(false)]),
            Kind::PendantHold => self.at_panel(Panel::Hold(true), span_ns, &[Panel::Hold(false)]),
            Kind::KeyOffRemote => self.at_panel(Panel::Remote(false), span_ns, &[Panel::Remote(true)]),
            Kind::ServoOff => self.at_panel(Panel::Servo(false), span_ns, &[]),
            Kind::RobotPower => self.at_panel(Panel::Power(false), span_ns, &[Panel::Power(true)]),
            Kind::NetworkLoss
            | Kind::NetworkDouble
            | Kind::NetworkOvertaking
            | Kind::NetworkDelay
            | Kind::RobotSilent => return self.network.begin(self.now_ns, happening),
            Kind::DiskFull => process.disk.fill((size * FULL_BYTES_MAX) as usize),
            Kind::DiskReadOnly => process.disk.protect(),
            Kind::DiskSlowFlush | Kind::DiskSlowSync => {
                let mut times = Times::default();
                if kind == Kind::DiskSlowFlush {
                    times.flush_ns = (size * FLUSH_NS_MAX) as u64;
                } else {
                    times.sync_ns = (size * SYNC_NS_MAX) as u64;
                }
                process.disk.set_times(times);
                self.send(span_ns, Delivery::DiskWell(self.process));
                until_ns += times.flush_ns.max(times.sync_ns);
            }
            Kind::Hold => return self.say(process, kind, Command::Hold),
            Kind::HoldAfterView => return self.say(process, kind, Command::HoldAfterView),
            Kind::Step => return self.say(process, kind, Command::Step),
            Kind::Stop => return self.say(process, kind, Command::Stop),
            Kind::Abort => return self.say(process, kind, Command::Abort),
            Kind::Kill => self.end = Some(Sudden::Kill),
            Kind::PowerCut => self.end = Some(Sudden::PowerCut),
            Kind::Camera => (),
        }
        self.meet(kind.name().to_owned(), kind, until_ns);
    }

    /// The operator says a word; it is met where it does something.
    fn say(&mut self, process: &mut Process, kind: Kind, word: Command) {
        if process.run.controller().state().accepts(word) {
            self.meet(kind.name().to_owned(), kind, self.now_ns);
        }
        self.tell_run(process, Input::Operator(word));
    }

    fn at_panel(&mut self, panel: Panel, span_ns: u64, put_right: &[Panel]) {
        self.ask_cell(cell::Input::Panel(panel));
        for (count, panel) in put_right.iter().enumerate() {
            self.send(span_ns + count as u64 * RESET_NS, Delivery::Panel(*panel));
        }
    }

    fn meet(&mut self, name: String, kind: Kind, until_ns: u64) {
        let met = self.met.entry(name).or_insert(Met {
            until_ns,
            kind,
            stopped_by: BTreeSet::new(),
            in_process: self.process,
        });
        met.until_ns = met.until_ns.max(until_ns);
        met.in_process = self.process;
    }

    pub(super) fn note_met_network(&mut self) {
        for kind in self.network.take_met() {
            self.meet(kind.name().to_owned(), kind, self.now_ns);
        }
    }

    pub(super) fn note_met_camera(&mut self) {
        let of_triggers: Vec<Fault> = self.cell.met_camera_faults().into_iter().map(Fault::Camera).collect();
        let is_of_run = |fault: &&Fault| !matches!(fault, Fault::Camera(_));
        let of_run: Vec<Fault> = self.faults.iter().filter(is_of_run).copied().collect();
        for fault in of_triggers.into_iter().chain(of_run) {
            let name = format!("camera: {}", row(&fault).0);
            if !self.met.contains_key(&name) {
                self.meet(name, Kind::Camera, u64::MAX);
            }
        }
    }

    /// Whatever ended the run must have been met.
    pub(super) fn handle_ending(&mut self, began_ns: u64, ending: Option<&Ending>) {
        let code = match ending {
            Some(Ending::Faulted { fault }) => fault.code.name(),
            Some(Ending::Aborted) => "aborted",
            Some(Ending::Finished) | None => return,
        };
        let process = self.process;
        let is_felt = |met: &Met| met.in_process == process || met.until_ns.saturating_add(FELT_NS) >= began_ns;
        let mut explained = false;
        for met in self.met.values_mut().filter(|met| is_felt(met)) {
            let allowed = met.kind.codes().contains(&code) || (code == "aborted" && is_word(met.kind));
            if allowed {
                met.stopped_by.insert(code.to_owned());
            }
            explained |= allowed;
        }
        if !explained {
            let met: Vec<&String> = self.met.keys().collect();
            let about = format!("{ending:?} after {met:?}");
            self.judge.wrong(Bar::Unexplained, about);
        }
    }
}

/// Whether a word of the operator may end a run.
fn is_word(kind: Kind) -> bool {
    matches!(kind, Kind::Abort | Kind::Stop)
}

/// Between putting right and a reset.
const RESET_NS: u64 = 300_000_000;
/// What was put right may be felt so much later.
const FELT_NS: u64 = 1_000_000_000;
const ALARM_CODE: u32 = 4315;
/// How much fits on a disk that is nearly full.
const FULL_BYTES_MAX: f64 = 200_000.0;
const FLUSH_NS_MAX: f64 = 3e9;
const SYNC_NS_MAX: f64 = 14e9;
