//! The conformance suite against the bridge: every clause that can be tried holds.

use super::*;
use crate::camera::conformance::{Permission, Told, Verdict, run};
use crate::camera::lines::{Carry, Deed, Lines, News};

/// The bridge with a vendor's side that takes its time, and time that passes only while somebody waits.
struct Server {
    bridge: Bridge,
    now: Stamp,
    /// Lines that the vendor's side will say.
    lines: BTreeMap<Stamp, Vec<String>>,
    /// Bytes on their way, in order; the network carries 100 MB/s.
    on_the_way: VecDeque<(Stamp, ConnectionId, Vec<u8>)>,
    free_at: Stamp,
    news: VecDeque<News>,
}

fn server() -> Carry<'static> {
    let mut server = Server {
        bridge: Bridge::new(&config(), 9),
        now: at(0),
        lines: BTreeMap::new(),
        on_the_way: VecDeque::new(),
        free_at: at(0),
        news: VecDeque::new(),
    };
    server.later(
        0,
        r#"{"is":"ready","vendor":"V","model":"M","serial":"S","simulated":true,"says_exposed":true}"#,
    );
    server.step(at(0));
    Box::new(move |deed| server.carry_out(deed))
}

impl Server {
    fn carry_out(&mut self, deed: Deed) -> (Stamp, Option<News>) {
        let news = match deed {
            Deed::Connect { line } => {
                self.bridge.handle_connected(self.now, connection(line), "somewhere");
                self.news.push_back(News::Connected { line });
                None
            }
            Deed::Bytes { line, bytes } => {
                self.bridge.handle_bytes(self.now, connection(line), &bytes);
                None
            }
            Deed::Close { line } => {
                self.bridge.handle_closed(self.now, connection(line));
                self.on_the_way.retain(|(_, id, _)| *id != connection(line));
                self.news.retain(|news| !is_of(news, line));
                None
            }
            Deed::Wait { until } => self.wait(until),
        };
        self.do_what_is_wanted();
        (self.now, news)
    }

    fn wait(&mut self, until: Stamp) -> Option<News> {
        loop {
            if let Some(news) = self.news.pop_front() {
                return Some(news);
            }
            if self.now >= until {
                return None;
            }
            let said = self.lines.keys().next().copied();
            let written = self.on_the_way.front().map(|(due, ..)| *due);
            let due = [self.bridge.wake_at(), said, written].into_iter().flatten().min();
            self.step(due.unwrap_or(until).max(self.now).min(until));
        }
    }

    fn step(&mut self, now: Stamp) {
        self.now = now;
        self.bridge.handle_wake(now);
        while let Some(entry) = self.lines.first_entry().filter(|entry| *entry.key() <= now) {
            for line in entry.remove() {
                self.bridge.handle_line(now, &line);
            }
        }
        while let Some((_, id, bytes)) = self.on_the_way.pop_front_if(|(due, ..)| *due <= now) {
            self.bridge.handle_written(now, id, bytes.len());
            let line = id.0 as usize;
            self.news.push_back(News::Bytes { line, bytes });
        }
        self.do_what_is_wanted();
    }

    fn do_what_is_wanted(&mut self) {
        while let Some(output) = self.bridge.poll_output() {
            match output {
                BridgeOutput::Bytes { connection, bytes } => {
                    let began = self.free_at.max(self.now);
                    self.free_at = Stamp {
                        ns: began.ns + 10 * bytes.len() as u64,
                    };
                    self.on_the_way.push_back((self.free_at, connection, bytes));
                }
                BridgeOutput::Close { connection } => {
                    // What was said before it arrives before it.
                    let (gone, rest): (VecDeque<_>, VecDeque<_>) =
                        self.on_the_way.drain(..).partition(|(_, id, _)| *id == connection);
                    self.on_the_way = rest;
                    let line = connection.0 as usize;
                    for (_, _, bytes) in gone {
                        self.news.push_back(News::Bytes { line, bytes });
                    }
                    let reason = "the bridge closed the connection".into();
                    self.news.push_back(News::Closed { line, reason });
                    self.bridge.handle_closed(self.now, connection);
                }
                BridgeOutput::Line(line) => self.answer(&line),
                BridgeOutput::Convert(conversion) => {
                    let [width_px, height_px] = conversion.wanted.size_px;
                    let pixels = (width_px * height_px) as usize;
                    let picture = Picture {
                        width_px,
                        height_px,
                        xyz: vec![0x41; 12 * pixels],
                        intensity: vec![90; pixels],
                        confidence: None,
                        mask: vec![0; pixels],
                        valid_count: pixels as u32,
                    };
                    self.bridge
                        .handle_picture(self.now, conversion.files.acquisition, Ok(picture));
                }
                BridgeOutput::StartVendor | BridgeOutput::Note(_) => {}
            }
        }
    }

    /// The vendor's side: settings at once, exposed after 150 ms, the frame after 400 ms.
    fn answer(&mut self, line: &str) {
        let order: Ask = serde_json::from_str(line).unwrap();
        match order {
            Ask::Configure { config_id, .. } => {
                self.later(5, &format!(r#"{{"is":"configured","config_id":{config_id}}}"#));
            }
            Ask::Acquire { acquisition, .. } => {
                self.later(150, &format!(r#"{{"is":"exposed","acquisition":{acquisition}}}"#));
                self.later(
                    400,
                    &format!(r#"{{"is":"frame","acquisition":{acquisition},"esm":"a"}}"#),
                );
            }
            Ask::Status | Ask::Abort { .. } | Ask::End => {}
        }
    }

    fn later(&mut self, ms: u64, line: &str) {
        let due = self.now.plus_ms(ms);
        self.lines.entry(due).or_default().push(line.to_owned());
    }
}

fn connection(line: usize) -> ConnectionId {
    ConnectionId(line as u64)
}

fn is_of(news: &News, wanted: usize) -> bool {
    let (News::Connected { line } | News::Bytes { line, .. } | News::Closed { line, .. }) = news;
    *line == wanted
}

#[test]
fn the_bridge_passes_every_clause_of_the_conformance_suite_that_can_be_tried() {
    let permission = Permission {
        exposures: true,
        first_run: 1_000_000,
    };
    let mut lines = Lines::new(server());
    let report = run(&mut lines, permission, &[], |_| {}).unwrap();
    let failures: Vec<&Told> = report
        .iter()
        .filter(|told| matches!(told.verdict, Verdict::Failed { .. }))
        .collect();
    assert!(failures.is_empty(), "{failures:#?}");
    let is_skipped = |told: &&Told| matches!(told.verdict, Verdict::Skipped { .. });
    let skipped: Vec<&str> = report.iter().filter(is_skipped).map(|told| told.id).collect();
    assert_eq!(
        skipped,
        ["3.1-offline", "3.1-fault", "3.1-resetting", "3.5-device-lost"]
    );
}
