//! The arm over a bad wire and in a bad cell.

mod carry;
mod draws;
mod drive;
mod noticed;
mod phases;
mod setup;
mod single;

use drive::drive;
use setup::{Ended, Link, Way};

/// Runs of one link and way, each of which must end as a run may.
fn all_are_sound(link: Link, way: Way, seeds: std::ops::RangeInclusive<u64>) {
    let mut finished_count = 0;
    for seed in seeds {
        let outcome = drive(&draws::setup(link, way, seed));
        assert!(outcome.is_sound(), "{link:?} {way:?} seed {seed}: {outcome:#?}");
        if link != Link::Serial {
            assert!(outcome.violations.is_empty(), "seed {seed}: {:?}", outcome.violations);
        }
        finished_count += u32::from(outcome.ended == Ended::Finished);
    }
    assert!(finished_count > 0);
}

#[test]
fn moves_over_bad_datagrams_are_made_once_and_end_where_they_were_sent() {
    all_are_sound(Link::Hses, Way::Direct, 1..=150);
}

#[test]
fn orders_over_datagrams_of_any_lateness_are_carried_out_once() {
    all_are_sound(Link::Hses, Way::Job, 1..=150);
}

#[test]
fn host_control_survives_broken_and_stalled_connections() {
    all_are_sound(Link::HostControl, Way::Direct, 1..=30);
    all_are_sound(Link::HostControl, Way::Job, 1..=30);
}

#[test]
fn host_control_survives_a_serial_line_with_wrong_characters() {
    all_are_sound(Link::Serial, Way::Direct, 1..=30);
    all_are_sound(Link::Serial, Way::Job, 1..=20);
}

#[test]
fn the_same_seed_sends_the_same_bytes_at_the_same_times() {
    let digest = |seed| drive(&draws::setup(Link::Hses, Way::Job, seed)).digest;
    assert_eq!(digest(3), digest(3));
    assert_ne!(digest(3), digest(4));
}
