use super::*;
use crate::robot::controller::Settings;
use crate::robot::files::SIMULATED_TEXT;
use crate::robot::host::bsc::TEXT_BYTES_MAX;

/// A host on a line that takes no time.
struct Bench {
    host: Link,
    serial: Serial,
    controller: Controller,
    now_ns: u64,
    violations: Vec<String>,
}

impl Bench {
    fn new() -> Self {
        Self {
            host: Link::new(Timing::default(), Contention::Yield),
            serial: Serial::new(Timing::default()),
            controller: Controller::new(Settings::default()),
            now_ns: 0,
            violations: Vec::new(),
        }
    }

    /// What comes back for a message.
    fn ask(&mut self, message: Message) -> Message {
        self.host.send(self.now_ns, message);
        for _ in 0..10_000 {
            while let Some(output) = self.host.poll_output() {
                match output {
                    LinkOutput::Bytes(bytes) => self.serial.handle_bytes(self.now_ns, &bytes, &mut self.controller),
                    LinkOutput::Message(message) => return message,
                    LinkOutput::Sent => (),
                    other => panic!("{other:?}"),
                }
            }
            match self.serial.poll_output() {
                Some(SerialOutput::Bytes(bytes)) => self.host.handle_bytes(self.now_ns, &bytes),
                Some(SerialOutput::Violation(what)) => self.violations.push(what),
                None => {
                    self.now_ns = self.serial.wake_at().unwrap();
                    self.serial.handle_wake(self.now_ns, &mut self.controller);
                }
            }
        }
        panic!("no answer");
    }

    fn says(&mut self, header: &str, text: &str) -> (String, String) {
        let message = self.ask(Message::new(header, text.as_bytes()));
        let text = super::text(&message.text());
        (message.header, text)
    }
}

fn pair(header: &str, text: &str) -> (String, String) {
    (header.to_owned(), text.to_owned())
}

#[test]
fn commands_are_answered_with_a_code_or_with_data() {
    let mut bench = Bench::new();
    for (command, header, answer) in [
        ("RSTATS\r", "90,001", "196,0\r"),
        ("SVON 1\r\r", "90,000", "0000\r"),
        ("RSTATS", "90,001", "196,64\r"),
        ("START SCAN1\r", "90,000", "4040\r"),
        ("DANCE\r", "90,000", "1010\r"),
        ("RJDIR *\r", "90,001", "SIMULATED\r"),
    ] {
        assert_eq!(bench.says("01,000", command), pair(header, answer), "{command}");
    }
    assert_eq!(bench.violations, [""; 0]);
    assert_eq!(bench.now_ns, 0);
}

#[test]
fn a_file_is_put_and_comes_back_byte_for_byte() {
    let comments = "'0123456789ABCDEF0123456789ABCDEF\r\n".repeat(50);
    let text = SIMULATED_TEXT
        .replace("//NAME SIMULATED", "//NAME SCAN1")
        .replace("END\r\n", &format!("{comments}END\r\n"));
    let mut bench = Bench::new();
    let put = Message::file("02,001", "SCAN1.JBI", text.as_bytes());
    assert!(put.blocks.len() > 5 && put.blocks.iter().all(|block| block.len() <= TEXT_BYTES_MAX));
    assert_eq!(bench.ask(put.clone()), Message::new("90,000", b"0000\r"));
    assert_eq!(bench.ask(Message::new("02,051", b"SCAN1.JBI\r")), put);
    assert_eq!(bench.says("01,000", "RJDIR *\r"), pair("90,001", "SCAN1,SIMULATED\r"));
}

#[test]
fn a_file_that_is_not_there_or_no_job_is_refused() {
    let mut bench = Bench::new();
    for (message, code) in [
        (Message::new("02,051", b"SCAN1.JBI\r"), "4040\r"),
        (Message::file("02,001", "SCAN1.JBI", b"MOVL\r\n"), "5170\r"),
        (Message::file("02,001", "SCAN1.DAT", b"1\r\n"), "1012\r"),
        (Message::file("02,099", "SCAN1.JBI", b"1\r\n"), "1012\r"),
    ] {
        let answer = bench.ask(message.clone());
        assert_eq!(answer, Message::new("90,000", code.as_bytes()), "{message:?}");
    }
}

#[test]
fn variables_and_signals_have_headers_of_their_own() {
    let mut bench = Bench::new();
    for (put, asked, text, number) in [
        ("03,001", "03,051", "5,255\r", "5\r"),
        ("03,003", "03,053", "5,-7\r", "5\r"),
        ("03,004", "03,054", "5,0.5\r", "5\r"),
        ("03,005", "03,055", "5,0,1,2,3,4,5,6,0,0,1\r", "5\r"),
        (
            "03,006",
            "03,056",
            "6,1,0,1.000,0.000,0.000,0.0000,0.0000,0.0000,1,1\r",
            "6\r",
        ),
        (
            "03,006",
            "03,056",
            "7,1,0,1.000,0.000,0.000,0.0000,0.0000,0.0000,1,1,8,-9\r",
            "7\r",
        ),
        ("04,001", "04,051", "27010,16,85,170\r", "27010,16\r"),
    ] {
        assert_eq!(bench.says(put, text), pair("90,000", "0000\r"), "{put}");
        assert_eq!(bench.says(asked, number), pair(put, text), "{asked}");
    }
    assert_eq!(bench.says("03,051", "60000\r"), pair("90,000", "1012\r"));
    assert_eq!(bench.says("03,009", "1,1\r"), pair("90,000", "1010\r"));
    assert_eq!(bench.says("04,051", "10011,8\r"), pair("90,000", "1012\r"));
    assert_eq!(bench.says("05,000", "\r"), pair("90,000", "1010\r"));
}

#[test]
fn jwait_is_answered_when_it_is_over() {
    let mut bench = Bench::new();
    bench.says("01,000", "SVON 1\r");
    bench.says("01,000", "MOVL 0,100,0,900,0,900,0,0,0,1,1,0,0,0,0,0,0\r");
    assert_eq!(bench.says("01,000", "JWAIT -1\r"), pair("90,001", "0\r"));
    assert!(
        (1_000_000_000..2_000_000_000).contains(&bench.now_ns),
        "{}",
        bench.now_ns
    );
}
