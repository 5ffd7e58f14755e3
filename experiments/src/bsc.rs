//! A recorded exchange on the serial line: the simulator's link must send what the recorded controller sent, byte for byte.

use std::collections::{BTreeMap, VecDeque};
use std::error::Error;

use hw_sim::robot::host::bsc::{Contention, Link, LinkOutput, Message, Timing};
use serde_json::Value;

use crate::golden::bytes;

/// Whether each burst of the recorded controller is met, in their order, with what the host sent before it.
pub(crate) fn check(capture: &[Value]) -> Result<Vec<(String, bool)>, Box<dyn Error>> {
    let mut responder = Responder::default();
    let mut verdicts = Vec::new();
    let mut sent = "nothing".to_owned();
    for burst in capture {
        let (Some(from), Some(digits)) = (burst["dir"].as_str(), burst["hex"].as_str()) else {
            continue;
        };
        if from == "host>ctrl" {
            responder.take(&bytes(&digits.into())?);
            sent = shortened(digits);
        } else {
            let said = responder.said.pop_front();
            let is_right = said == Some(bytes(&digits.into())?);
            verdicts.push((format!("{sent} -> {}", shortened(digits)), is_right));
        }
    }
    verdicts.push(("nothing is left to say".to_owned(), responder.said.is_empty()));
    Ok(verdicts)
}

/// The link of the simulated controller, before the answers of the recorded one.
struct Responder {
    link: Link,
    files: BTreeMap<String, Vec<u8>>,
    /// Bursts that nothing was compared with yet.
    said: VecDeque<Vec<u8>>,
}

impl Default for Responder {
    fn default() -> Self {
        Self {
            link: Link::new(Timing::default(), Contention::Insist),
            files: BTreeMap::new(),
            said: VecDeque::new(),
        }
    }
}

impl Responder {
    fn take(&mut self, bytes: &[u8]) {
        self.link.handle_bytes(0, bytes);
        while let Some(output) = self.link.poll_output() {
            match output {
                LinkOutput::Bytes(bytes) => self.said.push_back(bytes),
                LinkOutput::Message(message) => {
                    let answer = self.answer(&message);
                    self.link.send(0, answer);
                }
                LinkOutput::Sent | LinkOutput::Failed(_) | LinkOutput::Violation(_) => (),
            }
        }
    }

    fn answer(&mut self, message: &Message) -> Message {
        let text = message.text();
        let end = text.iter().position(|byte| *byte == b'\r').unwrap_or(text.len());
        let first = String::from_utf8_lossy(&text[..end]).into_owned();
        match (message.header.as_str(), first.as_str()) {
            ("01,000", "RSTATS") => Message::new("90,001", b"194,64\r"),
            ("01,000", "RPOSC 0,0") => Message::new("90,001", b"353.769,202.779,120.658,-1.34,35.78,27.84,0,0\r"),
            ("01,000", "START SCAN1") => Message::new("90,000", b"2010\r"),
            ("02,001", _) => {
                self.files.insert(first, text[end + 1..].to_vec());
                Message::new("90,000", b"0000\r")
            }
            ("02,051", _) => Message::file("02,001", &first, self.files.get(&first).map_or(&[], Vec::as_slice)),
            _ => Message::new("90,000", b"0000\r"),
        }
    }
}

fn shortened(digits: &str) -> String {
    if digits.len() > 40 {
        format!("{}.. ({} bytes)", &digits[..36], digits.len() / 2)
    } else {
        digits.to_owned()
    }
}
