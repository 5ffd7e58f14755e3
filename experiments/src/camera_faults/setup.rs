//! Runs drawn from a seed: which faults meet which triggers, and how the bytes are cut on their way.

use hw_sim::camera::trouble::{CameraFault, Phase, Trouble};
use hw_sim::fault::Fault;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What a run depends on.
#[derive(Debug, Clone)]
pub(crate) struct Setup {
    pub(crate) faults: Vec<Fault>,
    /// Longest piece that the camera's bytes come in.
    pub(crate) piece_bytes_max: usize,
    pub(crate) seed: u64,
}

/// How long what lasts may last, s.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spans {
    pub(crate) reset_s: f64,
    pub(crate) other_max_s: f64,
}

/// The run of this seed.
pub(crate) fn draw(seed: u64, spans: Spans) -> Setup {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let fault_count = chance.random_range(1..=4);
    let faults = (0..fault_count).map(|_| draw_fault(&mut chance, spans)).collect();
    Setup {
        faults,
        piece_bytes_max: if chance.random() { usize::MAX } else { 1000 },
        seed,
    }
}

/// Every fault at every phase, each alone at view 1.
pub(crate) fn each_alone(spans: Spans) -> Vec<Setup> {
    let of_triggers = CameraFault::all(1, 0, spans.other_max_s, 403);
    let of_triggers = of_triggers
        .into_iter()
        .map(|fault| Fault::Camera(with_span(fault, spans, spans.other_max_s)));
    let of_runs = [
        Fault::ConfigEcho,
        Fault::ControllerBusy { span_s: Some(3.0) },
        Fault::ControllerBusy { span_s: None },
        Fault::ColdStart { trigger_count: 3 },
    ];
    of_triggers
        .chain(of_runs)
        .map(|fault| Setup {
            faults: vec![fault],
            piece_bytes_max: usize::MAX,
            seed: 1,
        })
        .collect()
}

pub(crate) fn draw_fault(chance: &mut ChaCha8Rng, spans: Spans) -> Fault {
    if chance.random::<f64>() < OF_RUN_FRACTION {
        return match chance.random_range(0..8) {
            0 => Fault::ConfigEcho,
            1 => Fault::ControllerBusy { span_s: None },
            2..=4 => Fault::ColdStart {
                trigger_count: chance.random_range(1..6),
            },
            _ => Fault::ControllerBusy {
                span_s: Some(round(chance.random_range(0.1..spans.other_max_s))),
            },
        };
    }
    let view = chance.random_range(0..VIEW_COUNT as u32);
    let attempt = if chance.random::<f64>() < RETAKE_FRACTION { 1 } else { 0 };
    let span_s = round(chance.random_range(0.1..spans.other_max_s));
    let code = CODES[chance.random_range(0..CODES.len())];
    let all = CameraFault::all(view, attempt, span_s, code);
    let fault = all[chance.random_range(0..all.len())];
    Fault::Camera(with_span(fault, spans, span_s))
}

/// A reset takes its own time.
fn with_span(fault: CameraFault, spans: Spans, span_s: f64) -> CameraFault {
    let trouble = match fault.trouble {
        Trouble::Reset { .. } => Trouble::Reset { span_s: spans.reset_s },
        Trouble::Lost { .. } => Trouble::Lost { span_s },
        other => other,
    };
    CameraFault { trouble, ..fault }
}

fn round(span_s: f64) -> f64 {
    (span_s * 1e3).round() / 1e3
}

/// Name and phase of a fault, for a table.
pub(crate) fn row(fault: &Fault) -> (String, Option<Phase>) {
    match fault {
        Fault::Camera(fault) => (fault.name().to_owned(), Some(fault.phase)),
        other => (other.to_string().split('=').next().unwrap_or_default().to_owned(), None),
    }
}

/// Views of a run.
pub(crate) const VIEW_COUNT: usize = 4;
const OF_RUN_FRACTION: f64 = 0.06;
const RETAKE_FRACTION: f64 = 0.2;
const CODES: [u16; 8] = [401, 402, 403, 404, 405, 501, 505, 601];
