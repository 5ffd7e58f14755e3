//! What is noticed of an incident in each part of a run: as what, how soon, and how the run ends.

use super::carry::Weather;
use super::drive::drive;
use super::setup::{Happening, Link, Outcome, Phase, Setup, Way, When};
use bladescan::session::ArmEvent;
use hw_sim::robot::controller::Panel;

/// What comes of one incident.
#[derive(Debug)]
pub struct Seen {
    /// `held-elsewhere`, the code of a fault, or `nothing`.
    pub notice: &'static str,
    /// How long after the incident, ns.
    pub after_ns: Option<u64>,
    /// The whole run.
    pub outcome: Outcome,
}

/// The parts of a run, in order. Without a scan job, nothing is loaded or started.
pub fn phases(way: Way) -> &'static [Phase] {
    match way {
        Way::Job => &PHASES,
        Way::Direct => &PHASES_OF_MOVES,
    }
}

/// The run in which `incident` happens when `phase` begins. A hold at the pendant is released 1.5 s later.
pub fn incident_in(link: Link, way: Way, phase: Phase, incident: Panel) -> Seen {
    let mut incidents = Vec::new();
    if matches!(phase, Phase::Held | Phase::Resuming) {
        incidents.push((When::In(Phase::Moving), Happening::OperatorHold));
    }
    let index = incidents.len();
    incidents.push((When::In(phase), Happening::Panel(incident)));
    if incident == Panel::Hold(true) {
        incidents.push((When::After(1_500_000_000), Happening::Panel(Panel::Hold(false))));
    }
    let outcome = drive(&Setup {
        link,
        way,
        target_count: 3,
        weather: Weather::default(),
        tampers: Vec::new(),
        faults: Vec::new(),
        incidents,
        exposure_ns: 2_000_000_000,
        seed: 1,
    });
    let begun_ns = outcome.incident_ns.get(index).copied();
    let noticed = outcome.events.iter().find_map(|(at_ns, event)| {
        let name = match event {
            ArmEvent::HeldElsewhere => "held-elsewhere",
            ArmEvent::Fault(fault) => fault.code.name(),
            _ => return None,
        };
        begun_ns
            .filter(|begun_ns| begun_ns <= at_ns)
            .map(|begun_ns| (name, at_ns - begun_ns))
    });
    Seen {
        notice: noticed.map_or("nothing", |(name, _)| name),
        after_ns: noticed.map(|(_, after_ns)| after_ns),
        outcome,
    }
}

/// What happens.
pub const INCIDENTS: [Panel; 7] = [
    Panel::EmergencyStop(true),
    Panel::Door(true),
    Panel::Hold(true),
    Panel::Alarm(4315),
    Panel::Servo(false),
    Panel::Power(false),
    Panel::Remote(false),
];

const PHASES: [Phase; 11] = [
    Phase::Identifying,
    Phase::Readying,
    Phase::ServoOn,
    Phase::Loading,
    Phase::Starting,
    Phase::Moving,
    Phase::Settling,
    Phase::Standing,
    Phase::Held,
    Phase::Resuming,
    Phase::Parking,
];
const PHASES_OF_MOVES: [Phase; 9] = [
    Phase::Identifying,
    Phase::Readying,
    Phase::ServoOn,
    Phase::Moving,
    Phase::Settling,
    Phase::Standing,
    Phase::Held,
    Phase::Resuming,
    Phase::Parking,
];
