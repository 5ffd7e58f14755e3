//! Runs whose disk is full at some record: a selection; `experiments disk` makes one of each.

use super::*;
use std::io::{self, ErrorKind, SeekFrom};

/// A disk in memory that takes no more bytes than it has room for.
struct Disk {
    bytes: Cursor<Vec<u8>>,
    room: u64,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let left = self.room.saturating_sub(self.bytes.position()) as usize;
        if left == 0 && !bytes.is_empty() {
            return Err(ErrorKind::StorageFull.into());
        }
        self.bytes.write(&bytes[..bytes.len().min(left)])
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.bytes.seek(to)
    }
}

/// What a run left: its bytes on the disk, its events, how it ended, and whether servo power was switched off.
fn run_with(room: u64) -> (Vec<u8>, Vec<(u64, Event)>, Ending, bool) {
    let disk = Disk {
        bytes: Cursor::new(Vec::new()),
        room,
    };
    let mut pair = Pair::recorded_on(disk, (RECIPE, Station::BUILTIN_SIMULATED_TEXT), 2, &[], 0.0, 1);
    let ending = pair.drive(|_| None);
    let (_, journal) = pair.run.into_parts();
    (
        journal.abandon().bytes.into_inner(),
        pair.events,
        ending,
        pair.servo_off_count > 0,
    )
}

#[test]
fn wherever_the_disk_is_full_the_arm_is_held_and_what_was_kept_is_there() {
    let (whole, _, ending, _) = run_with(u64::MAX);
    assert_eq!(ending, Ending::Finished);
    let length = whole.len() as u64;
    for part in [20, 30, 45, 60, 75] {
        let room = length * part / 100;
        let (bytes, events, ending, is_off) = run_with(room);
        assert_eq!(Pair::fault_name(&ending), "journal", "{part} %: {ending:?}");
        assert!(
            bytes == whole[..room as usize],
            "{part} %: not the run's first {room} bytes"
        );
        let failed = events
            .iter()
            .position(|(_, event)| matches!(event, Event::Faulted { .. }))
            .unwrap();
        let held = events[failed..]
            .iter()
            .any(|(_, event)| matches!(event, Event::HoldAsked { .. }));
        let arrived = |(_, event): &&(u64, Event)| matches!(event, Event::FrameArrived { .. });
        let all_is_taken = events[..failed].iter().filter(arrived).count() == 2;
        // At its end a run is not held but switched off.
        assert!(held || all_is_taken && is_off, "{part} %: no hold");
        let recording = Recording::open(&bytes).unwrap();
        let records: Vec<_> = recording.records().unwrap().map_while(Result::ok).collect();
        for (_, event) in &events {
            if let Event::FrameKept { view_index, attempt } = event {
                let frame = format!(r#"{{"attempt":{attempt},"output":"sync","view_index":{view_index}}}"#);
                let is_there = records.iter().any(|record| record.payload == frame.as_bytes());
                assert!(is_there, "{part} %: {frame}");
            }
        }
    }
}
