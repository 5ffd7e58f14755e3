//! Runs drawn from a seed: a bad wire, and in some of them something that happens in the cell.

use super::carry::Weather;
use super::setup::{Happening, Link, Setup, Way, When};
use hw_sim::fault::Fault;
use hw_sim::robot::controller::Panel;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The run of this seed.
pub fn setup(link: Link, way: Way, seed: u64) -> Setup {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let target_count = chance.random_range(6..=8);
    let mut faults = faults_of_link(link);
    let mut incidents = Vec::new();
    if chance.random::<f64>() < INCIDENT_FRACTION {
        draw_incident(&mut chance, link, target_count, &mut faults, &mut incidents);
    }
    Setup {
        link,
        way,
        target_count,
        weather: weather(link, way),
        tampers: Vec::new(),
        faults,
        incidents,
        exposure_ns: 150_000_000,
        seed,
    }
}

fn draw_incident(
    chance: &mut ChaCha8Rng,
    link: Link,
    target_count: usize,
    faults: &mut Vec<Fault>,
    incidents: &mut Vec<(When, Happening)>,
) {
    let at = When::At(chance.random_range(0..span_ns(link)));
    let after = When::After(chance.random_range(200_000_000..3_000_000_000));
    let view = chance.random_range(0..target_count) as u32;
    let span_s = chance.random_range(0.2..4.0);
    let panel = |when, panel| (when, Happening::Panel(panel));
    match chance.random_range(0..12) {
        0 | 1 => incidents.extend([panel(at, Panel::Hold(true)), panel(after, Panel::Hold(false))]),
        2 | 3 => incidents.push((at, Happening::OperatorHold)),
        4 => incidents.push(panel(at, Panel::Alarm(4315))),
        5 => incidents.push(panel(at, Panel::EmergencyStop(true))),
        6 => incidents.push(panel(at, Panel::Door(true))),
        7 => incidents.push(panel(at, Panel::Servo(false))),
        8 => incidents.extend([panel(at, Panel::Power(false)), panel(after, Panel::Power(true))]),
        9 => faults.push(Fault::Busy { span_s, view }),
        10 => faults.push(Fault::Stall { view }),
        _ if link == Link::HostControl => incidents.extend([(at, Happening::Cut), (after, Happening::Cut)]),
        // Held, released at once and held again: the worst for what is still on its way.
        _ => incidents.extend([
            (at, Happening::OperatorHold),
            (When::After(1_300_000_000), Happening::OperatorHold),
        ]),
    }
}

/// Datagrams of moves are never later than the shortest move takes (0.7 s); those of the scan job may be.
fn weather(link: Link, way: Way) -> Weather {
    match (link, way) {
        (Link::Hses, Way::Direct) => Weather {
            late_fraction: 0.1,
            late_ns_max: 400_000_000,
            ..DATAGRAMS
        },
        (Link::Hses, Way::Job) => Weather {
            late_fraction: 0.1,
            late_ns_max: 400_000_000,
            very_late_fraction: 0.02,
            very_late_ns_max: 30_000_000_000,
            ..DATAGRAMS
        },
        (Link::HostControl, _) => Weather::default(),
        (Link::Serial, _) => Weather {
            double_fraction: 0.001,
            ..Weather::default()
        },
    }
}

/// What the simulator's own network does to streams.
fn faults_of_link(link: Link) -> Vec<Fault> {
    match link {
        Link::Hses => Vec::new(),
        Link::HostControl => vec![Fault::NetLoss { fraction: 0.05 }, Fault::NetReorder { fraction: 0.05 }],
        Link::Serial => vec![Fault::NetLoss { fraction: 0.001 }, Fault::NetFlip { fraction: 0.001 }],
    }
}

/// About as long as a run without incidents takes.
fn span_ns(link: Link) -> u64 {
    match link {
        Link::Hses => 14_000_000_000,
        Link::HostControl => 16_000_000_000,
        Link::Serial => 40_000_000_000,
    }
}

const INCIDENT_FRACTION: f64 = 0.5;
const DATAGRAMS: Weather = Weather {
    loss_fraction: 0.05,
    double_fraction: 0.02,
    late_fraction: 0.0,
    late_ns_max: 0,
    very_late_fraction: 0.0,
    very_late_ns_max: 0,
};
