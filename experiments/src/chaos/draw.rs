//! What happens in the run of a seed.

use hw_sim::fault::Fault;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::camera_faults::setup::{Spans, draw_fault};

/// A kind of thing that happens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Alarm,
    EmergencyStop,
    Door,
    PendantHold,
    KeyOffRemote,
    ServoOff,
    RobotPower,
    NetworkLoss,
    NetworkDouble,
    NetworkOvertaking,
    NetworkDelay,
    RobotSilent,
    Camera,
    DiskFull,
    DiskReadOnly,
    DiskSlowFlush,
    DiskSlowSync,
    Hold,
    HoldAfterView,
    Step,
    Stop,
    Abort,
    Kill,
    PowerCut,
}

/// When a thing happens.
#[derive(Debug, Clone, Copy)]
pub(super) enum When {
    /// So long after the run began; times in which no process carries it do not count.
    At(u64),
    /// So long after this event, counted from 0 over all processes.
    After(usize, u64),
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Happening {
    pub(super) kind: Kind,
    pub(super) when: When,
    /// How long it lasts, ns.
    pub(super) span_ns: u64,
    /// How bad it is, 0 to 1.
    pub(super) size: f64,
}

/// What a run depends on.
#[derive(Debug, Clone)]
pub(super) struct Setup {
    pub(super) seed: u64,
    pub(super) view_count: usize,
    pub(super) happenings: Vec<Happening>,
    pub(super) camera_faults: Vec<Fault>,
    /// Longest piece that the camera's bytes come in.
    pub(super) piece_bytes_max: usize,
    pub(super) job_ns: u64,
    /// Whether the first process that sees its run to the end is killed before the end of its recording.
    pub(super) ends_abruptly: bool,
    /// Whether its recording is replayed at the end.
    pub(super) is_replayed: bool,
}

impl Kind {
    /// Every kind, with how often it is drawn.
    const ALL: [(Self, u32); 24] = [
        (Self::Alarm, 2),
        (Self::EmergencyStop, 2),
        (Self::Door, 2),
        (Self::PendantHold, 2),
        (Self::KeyOffRemote, 2),
        (Self::ServoOff, 2),
        (Self::RobotPower, 2),
        (Self::NetworkLoss, 3),
        (Self::NetworkDouble, 3),
        (Self::NetworkOvertaking, 3),
        (Self::NetworkDelay, 2),
        (Self::RobotSilent, 2),
        (Self::Camera, 12),
        (Self::DiskFull, 3),
        (Self::DiskReadOnly, 3),
        (Self::DiskSlowFlush, 3),
        (Self::DiskSlowSync, 3),
        (Self::Hold, 3),
        (Self::HoldAfterView, 3),
        (Self::Step, 2),
        (Self::Stop, 2),
        (Self::Abort, 3),
        (Self::Kill, 12),
        (Self::PowerCut, 8),
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Alarm => "robot: alarm",
            Self::EmergencyStop => "robot: emergency stop",
            Self::Door => "robot: door",
            Self::PendantHold => "robot: hold at the pendant",
            Self::KeyOffRemote => "robot: key off remote",
            Self::ServoOff => "robot: servo power off",
            Self::RobotPower => "robot: power lost and back",
            Self::NetworkLoss => "network: datagrams lost",
            Self::NetworkDouble => "network: datagrams doubled",
            Self::NetworkOvertaking => "network: datagrams overtaken",
            Self::NetworkDelay => "network: datagrams late",
            Self::RobotSilent => "network: robot silent for a while",
            Self::Camera => "camera",
            Self::DiskFull => "disk: full",
            Self::DiskReadOnly => "disk: read-only",
            Self::DiskSlowFlush => "disk: slow writes",
            Self::DiskSlowSync => "disk: slow sync",
            Self::Hold => "operator: hold",
            Self::HoldAfterView => "operator: hold after view",
            Self::Step => "operator: step",
            Self::Stop => "operator: stop",
            Self::Abort => "operator: abort",
            Self::Kill => "process: killed",
            Self::PowerCut => "process: power cut",
        }
    }

    /// What a run may be stopped with because of it.
    pub(super) fn codes(self) -> &'static [&'static str] {
        match self {
            Self::Alarm => &["robot-alarm"],
            Self::EmergencyStop => &["robot-servo", "robot-alarm"],
            Self::Door | Self::ServoOff => &["robot-servo"],
            Self::KeyOffRemote => &["robot-not-remote"],
            Self::RobotPower => &["robot-silent", "robot-not-held", "robot-servo"],
            // A move that is lost three times over leaves the arm where it stood.
            Self::NetworkLoss => &["robot-silent", "robot-not-held", "robot-elsewhere"],
            Self::NetworkDelay | Self::RobotSilent => &["robot-silent", "robot-not-held"],
            Self::Camera => &[
                "camera-lost",
                "camera-silent",
                "camera-protocol",
                "camera-settings",
                "camera-refused",
                "camera-not-ready",
                "camera-failing",
            ],
            Self::DiskFull | Self::DiskReadOnly | Self::DiskSlowFlush | Self::DiskSlowSync => &["journal"],
            Self::PendantHold
            | Self::NetworkDouble
            | Self::NetworkOvertaking
            | Self::Hold
            | Self::HoldAfterView
            | Self::Step
            | Self::Stop
            | Self::Abort
            | Self::Kill
            | Self::PowerCut => &[],
        }
    }
}

/// The run of this seed. A run of `view_count` views takes `clean_ns(view_count)` when nothing happens.
pub(super) fn draw(seed: u64, clean_ns: impl Fn(usize) -> u64) -> Setup {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let view_count = chance.random_range(2..=VIEW_COUNT_MAX);
    let count = chance.random_range(1..=4);
    let (mut happenings, mut camera_faults) = (Vec::new(), Vec::new());
    for _ in 0..count {
        match draw_kind(&mut chance) {
            Kind::Camera => camera_faults.push(draw_fault(&mut chance, SPANS)),
            kind => happenings.push(draw_happening(&mut chance, kind, view_count, clean_ns(view_count))),
        }
    }
    Setup {
        seed,
        view_count,
        happenings,
        camera_faults,
        piece_bytes_max: if chance.random() { usize::MAX } else { 1000 },
        job_ns: chance.random_range(20_000_000..600_000_000),
        ends_abruptly: chance.random::<f64>() < ENDS_ABRUPTLY_FRACTION,
        is_replayed: true,
    }
}

fn draw_kind(chance: &mut ChaCha8Rng) -> Kind {
    let total: u32 = Kind::ALL.iter().map(|(_, weight)| weight).sum();
    let mut left = chance.random_range(0..total);
    for (kind, weight) in Kind::ALL {
        if left < weight {
            return kind;
        }
        left -= weight;
    }
    unreachable!("the draw is below the sum of all weights")
}

fn draw_happening(chance: &mut ChaCha8Rng, kind: Kind, view_count: usize, clean_ns: u64) -> Happening {
    let when = if chance.random() {
        When::At(chance.random_range(0..clean_ns))
    } else {
        let event = chance.random_range(0..EVENTS_BEFORE + EVENTS_PER_VIEW * view_count);
        When::After(event, chance.random_range(0..AFTER_NS_MAX))
    };
    let span_s = match kind {
        Kind::NetworkLoss | Kind::NetworkDouble | Kind::NetworkOvertaking | Kind::NetworkDelay => 1.0..30.0,
        Kind::RobotSilent => 0.2..4.0,
        Kind::DiskSlowFlush | Kind::DiskSlowSync => 0.5..30.0,
        _ => 0.2..8.0,
    };
    Happening {
        kind,
        when,
        span_ns: (chance.random_range(span_s) * 1e9) as u64,
        size: chance.random(),
    }
}

const SPANS: Spans = Spans {
    reset_s: 8.0,
    other_max_s: 15.0,
};
/// Seed of runs in which nothing happens; no other has it.
pub(super) const UNBROKEN_SEED: u64 = 0;
pub(super) const VIEW_COUNT_MAX: usize = 4;
/// Events of a run before its first view, and about as many as a view has.
const EVENTS_BEFORE: usize = 6;
const EVENTS_PER_VIEW: usize = 9;
const AFTER_NS_MAX: u64 = 20_000_000;
const ENDS_ABRUPTLY_FRACTION: f64 = 0.2;
