//! The table of `docs/faults.md`: what is noticed, how soon, as what.

use super::phases::{INCIDENTS, incident_in, phases};
use super::setup::{Ended, Link, Phase, Way};
use hw_sim::robot::controller::Panel;

/// What is noticed of `incident`, if anything is.
fn notice(link: Link, phase: Phase, incident: Panel) -> Option<&'static str> {
    // Servo power is on only from there on; before, a drop is put right without a word.
    let servo_is_off = matches!(
        phase,
        Phase::Identifying | Phase::Readying | Phase::ServoOn | Phase::Held | Phase::Resuming
    );
    match incident {
        _ if phase == Phase::Parking => None,
        Panel::Servo(false) if servo_is_off => None,
        Panel::EmergencyStop(_) | Panel::Door(_) | Panel::Servo(_) => Some("robot-servo"),
        Panel::Hold(_) => Some("held-elsewhere"),
        Panel::Alarm(_) => Some("robot-alarm"),
        Panel::Power(_) if link == Link::HostControl => Some("robot-unreachable"),
        Panel::Power(_) => Some("robot-silent"),
        Panel::Remote(_) => Some("robot-not-remote"),
        other => panic!("{other:?} is not in the table"),
    }
}

/// The longest that it takes, ms.
fn noticed_within_ms(link: Link, phase: Phase, incident: Panel) -> u64 {
    let looks_ms = match phase {
        Phase::Standing => 500,
        // The operator resumes a second later; while it is held nothing is asked.
        Phase::Held => 1000,
        _ => 0,
    };
    let is_power = matches!(incident, Panel::Power(_));
    looks_ms
        + match (link, is_power) {
            // A poll interval of 20 ms and some round trips; five unanswered questions of 300 ms, and an act before them.
            (Link::Hses, false) => 30,
            (Link::Hses, true) => 1800,
            // A command takes 50 ms, and what is being loaded is loaded first; a line may take 1 s.
            (_, false) => 1000,
            (_, true) => 6500,
        }
}

fn is_as_in_the_table(link: Link, way: Way) {
    for phase in phases(way) {
        for incident in INCIDENTS {
            let seen = incident_in(link, way, *phase, incident);
            let place = format!("{link:?} {way:?} {phase:?} {incident:?}: {seen:#?}");
            let wanted = notice(link, *phase, incident);
            assert!(seen.outcome.is_sound(), "{place}");
            assert_eq!(seen.notice, wanted.unwrap_or("nothing"), "{place}");
            // A hold at the pendant that is released can be resumed from.
            let ended = match wanted {
                None | Some("held-elsewhere") => Ended::Finished,
                Some(code) => Ended::Fault(code),
            };
            assert_eq!(seen.outcome.ended, ended, "{place}");
            let bound_ms = noticed_within_ms(link, *phase, incident);
            assert!(seen.after_ns.is_none_or(|ns| ns <= bound_ms * 1_000_000), "{place}");
        }
    }
}

#[test]
fn every_incident_in_every_part_of_a_run_over_datagrams_is_noticed_in_time() {
    is_as_in_the_table(Link::Hses, Way::Direct);
    is_as_in_the_table(Link::Hses, Way::Job);
}

#[test]
fn every_incident_in_every_part_of_a_run_over_host_control_is_noticed_in_time() {
    is_as_in_the_table(Link::HostControl, Way::Direct);
    is_as_in_the_table(Link::HostControl, Way::Job);
}
