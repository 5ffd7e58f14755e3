use super::*;
use crate::camera::wire::{FrameReader, HEADER_BYTES};
use crate::vectors::a3dp;
use std::cell::RefCell;
use std::collections::VecDeque;

/// A server that says what it was given when time reaches it, and keeps what it is told.
#[derive(Default)]
struct Script {
    now: Stamp,
    news: VecDeque<(u64, News)>,
    told: Vec<u8>,
    closed: bool,
}

impl Script {
    fn carry_out(&mut self, deed: Deed) -> (Stamp, Option<News>) {
        let news = match deed {
            Deed::Connect { line } => {
                self.news.push_front((0, News::Connected { line }));
                None
            }
            Deed::Bytes { bytes, .. } => {
                self.told.extend(bytes);
                None
            }
            Deed::Close { .. } => {
                self.closed = true;
                None
            }
            Deed::Wait { until } => {
                let due = self.news.front().map(|(ms, _)| Stamp::START.plus_ms(*ms));
                self.now = due.unwrap_or(until).min(until).max(self.now);
                let is_due = due.is_some_and(|due| due <= self.now);
                is_due.then(|| self.news.pop_front().map(|(_, news)| news)).flatten()
            }
        };
        (self.now, news)
    }

    fn told_kinds(&self) -> Vec<(u16, u16)> {
        let mut reader = FrameReader::default();
        reader.push(&self.told);
        let mut kinds = Vec::new();
        while let Some(frame) = reader.next_frame().unwrap() {
            kinds.push((frame.kind, frame.flags));
        }
        kinds
    }
}

/// Frames of the page, renumbered from 0.
fn frames(names: &[&str]) -> Vec<u8> {
    let mut writer = crate::camera::wire::FrameWriter::default();
    let mut bytes = Vec::new();
    for name in names {
        let frame = a3dp(name);
        let field = |at: usize| u16::from_le_bytes([frame[at], frame[at + 1]]);
        let request_id = u32::from(field(12));
        bytes.extend(writer.write_with(field(6), request_id, field(20), |payload| {
            payload.extend_from_slice(&frame[HEADER_BYTES..]);
        }));
    }
    bytes
}

fn lines<'a>(script: &'a RefCell<Script>, names: &[&str]) -> Lines<'a> {
    let bytes = frames(names);
    script.borrow_mut().news.push_back((10, News::Bytes { line: 0, bytes }));
    Lines::new(Box::new(|deed| script.borrow_mut().carry_out(deed)))
}

#[test]
fn a_reply_is_found_behind_what_came_before_it_and_the_rest_stays_in_order() {
    let script = RefCell::default();
    let mut lines = lines(&script, &["hello_ok", "frame_end", "aborted", "status"]);
    let line = lines.connect().unwrap();
    assert_eq!(lines.reply(line, 7, "ABORTED", 100).unwrap().kind, 0x41);
    assert_eq!(lines.hear(line, "any", 100).unwrap().kind, 0x02);
    assert_eq!(lines.hear(line, "any", 100).unwrap().kind, 0x32);
    assert_eq!(lines.line(line).statuses().len(), 1, "a status is noted, not heard");
    assert!(matches!(lines.hear(line, "any", 100), Err(LineError::Silent { .. })));
}

#[test]
fn from_the_greeting_on_the_line_is_kept_alive_until_it_falls_silent() {
    let script = RefCell::default();
    let mut lines = lines(&script, &["hello_ok"]);
    let line = lines.connect().unwrap();
    lines.pass(3000);
    assert_eq!(script.borrow().told_kinds(), [(0x60, 0); 3]);
    lines.fall_silent(line);
    lines.pass(3000);
    assert_eq!(script.borrow().told_kinds().len(), 3);
}

#[test]
fn a_frame_that_breaks_the_page_is_told_with_its_bytes() {
    let script = RefCell::default();
    let mut bytes = frames(&["hello_ok", "status"]);
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    let mut lines = lines(&script, &[]);
    script.borrow_mut().news.push_back((20, News::Bytes { line: 0, bytes }));
    let line = lines.connect().unwrap();
    lines.hear(line, "HELLO_OK", 100).unwrap();
    let error = lines.hear(line, "any", 100).unwrap_err();
    assert_eq!(error, LineError::Protocol("the payload CRC does not fit".into()));
}

#[test]
fn a_goodbye_is_part_of_why_a_line_has_ended() {
    let script = RefCell::default();
    let mut lines = lines(&script, &["bye"]);
    let reason = "end of stream".to_owned();
    script
        .borrow_mut()
        .news
        .push_back((20, News::Closed { line: 0, reason }));
    let line = lines.connect().unwrap();
    assert_eq!(lines.hear(line, "any", 100).unwrap().kind, 0x7F);
    let error = lines.hear(line, "any", 100).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the connection has ended: end of stream after BYE 1: done"
    );
    lines.close(line);
    assert!(!script.borrow().closed, "what has ended is not closed again");
}
