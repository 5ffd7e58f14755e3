//! Starts the program as a person would, with deadlines, and looks at what it leaves behind.

use bladescan::journal::{Record, Recording, Topic, Writer};
use bladescan::settings::Station;
use serde_json::Value;
use std::io::{BufRead as _, BufReader, Cursor, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// A recipe whose frames are a small part of the sensor, so that a view takes a fraction of a second.
pub const RECIPE: &str = r#"name = "tiny"

[blade]
cad = "builtin:hpt-a"

[views]
step_deg = 10.0
views_min = 2

[presentation]
position_mm = [0.0, 0.0, 280.0]
rotation_deg = [0.0, 90.0, 0.0]

[camera]
optics = "fine"
roi_px = [240, 160, 600, 460]
points_min = 500

[merge]
overlap_min_fraction = 0.5

[run]
retakes_max = 1
"#;

/// A folder for one test, with [`RECIPE`] as `tiny.toml` in it. The program runs in it.
pub struct Bench {
    folder: PathBuf,
}

impl Bench {
    /// An empty folder of that name.
    pub fn new(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        if folder.exists() {
            std::fs::remove_dir_all(&folder).unwrap();
        }
        std::fs::create_dir_all(&folder).unwrap();
        let bench = Self { folder };
        bench.write("tiny.toml", RECIPE);
        bench
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), content).unwrap();
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub fn read_json(&self, name: &str) -> Value {
        serde_json::from_slice(&self.read(name)).unwrap()
    }

    /// The names in a folder, sorted.
    pub fn names(&self, folder: &str) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(self.path(folder))
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// Starts the program.
    pub fn start(&self, words: &[&str]) -> Process {
        self.start_with(words, &[])
    }

    /// Starts the program with variables of the environment.
    pub fn start_with(&self, words: &[&str], variables: &[(&str, &str)]) -> Process {
        let mut command = Command::new(env!("CARGO_BIN_EXE_bladescan"));
        command
            .args(words)
            .envs(variables.iter().copied())
            .current_dir(&self.folder);
        Process::start(command)
    }

    /// Runs the program to its end.
    pub fn run(&self, words: &[&str]) -> Ended {
        self.start(words).end()
    }

    /// A dry run of the first views of `tiny.toml` into `out`, replayed from its recording.
    pub fn dry_run(&self, view_count: usize, options: &[&str]) -> Ended {
        self.dry_run_into("out", view_count, options, &[])
    }

    /// The same into another folder.
    pub fn dry_run_into(&self, out: &str, view_count: usize, options: &[&str], variables: &[(&str, &str)]) -> Ended {
        let view_count = view_count.to_string();
        let mut words = vec!["dry-run", "tiny.toml", "--out", out, "--views", &view_count];
        if !options.contains(&"--speed") {
            words.extend(["--speed", "1000"]);
        }
        words.extend(options);
        let ended = self.start_with(&words, variables).end();
        self.holds_a_whole_run(out, view_count.parse().unwrap());
        ended
    }

    /// Whatever became of the run: every planned view is accounted for, the counts agree, the recording replays.
    pub fn holds_a_whole_run(&self, out: &str, view_count: usize) {
        let poses = self.read_json(&format!("{out}/poses.json"));
        assert_eq!(poses["frame"], "view_0");
        let views = poses["views"].as_array().unwrap();
        assert_eq!(views.len(), view_count, "{poses}");
        for (index, view) in views.iter().enumerate() {
            assert_eq!(view["index"], index);
            let merged = view["status"] == "merged";
            assert!(
                merged || view["status"] == "discarded" || view["status"] == "missing",
                "{view}"
            );
            assert_eq!(view["model_from_view"].is_array(), merged, "{view}");
            assert_eq!(view["reason"].is_string(), !merged, "{view}");
        }
        let summary = self.read_json(&format!("{out}/summary.json"));
        assert_eq!(summary["counts"]["planned"], view_count);
        for status in ["merged", "discarded", "missing"] {
            let count = views.iter().filter(|view| view["status"] == status).count();
            assert_eq!(summary["counts"][status], count, "{status}");
        }
        let replayed = self.run(&["replay", &format!("{out}/run.mcap")]);
        assert_eq!(replayed.code, 0, "{replayed:?}");
        assert!(replayed.stdout.ends_with("\nbit-identical\n"), "{replayed:?}");
    }

    /// What became of each view, as `poses.json` says.
    pub fn statuses(&self, out: &str) -> Vec<String> {
        let poses = self.read_json(&format!("{out}/poses.json"));
        let views = poses["views"].as_array().unwrap();
        views
            .iter()
            .map(|view| view["status"].as_str().unwrap().to_owned())
            .collect()
    }

    /// The records of a recording.
    pub fn records(&self, recording: &str) -> Vec<Record> {
        let bytes = self.read(recording);
        let recording = Recording::open(&bytes).unwrap();
        recording.records().unwrap().map(Result::unwrap).collect()
    }

    /// The events of a recording.
    pub fn events(&self, recording: &str) -> Vec<Value> {
        self.records(recording)
            .iter()
            .filter(|record| record.topic == Topic::Event)
            .map(|record| serde_json::from_slice(&record.payload).unwrap())
            .collect()
    }

    /// Writes the recording `from` as `to`, with other records.
    pub fn rewrite(&self, from: &str, to: &str, records: &[Record]) {
        let bytes = self.read(from);
        let recording = Recording::open(&bytes).unwrap();
        let mut writer = Writer::begin(
            Cursor::new(Vec::new()),
            recording.header(),
            recording.start_unix_ns(),
            recording.recipe_text(),
            recording.station_text(),
        )
        .unwrap();
        for record in records {
            writer.write(record).unwrap();
        }
        self.write(to, writer.finish().unwrap().into_inner());
    }
}

/// How a program ended and what it said.
#[derive(Debug)]
pub struct Ended {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Ended {
    /// Asserts the exit code and that standard error has each of the texts.
    #[track_caller]
    pub fn expect(&self, code: i32, texts: &[&str]) {
        assert_eq!(self.code, code, "{}", self.stderr);
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
        for text in texts {
            assert!(self.stderr.contains(text), "`{text}` is not in:\n{}", self.stderr);
        }
    }
}

/// A running program. Every wait has a deadline; what still runs when a test fails is killed.
pub struct Process {
    child: Child,
    stdin: Option<ChildStdin>,
    stdout: Receiver<String>,
    stderr: Receiver<String>,
    said_on_stdout: String,
    said_on_stderr: String,
    deadline: Instant,
}

impl Process {
    fn start(mut command: Command) -> Self {
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self {
            stdin: child.stdin.take(),
            stdout: lines(child.stdout.take().unwrap()),
            stderr: lines(child.stderr.take().unwrap()),
            said_on_stdout: String::new(),
            said_on_stderr: String::new(),
            deadline: Instant::now() + PATIENCE,
            child,
        }
    }

    /// Waits for a line on standard error that contains the text.
    #[track_caller]
    pub fn wait_for(&mut self, text: &str) {
        loop {
            match next_line(&self.stderr, self.deadline) {
                Some(line) => {
                    self.said_on_stderr.push_str(&line);
                    if line.contains(text) {
                        return;
                    }
                }
                None => panic!("it ended without `{text}`:\n{}", self.said_on_stderr),
            }
        }
    }

    /// Waits for a line on standard output.
    #[track_caller]
    pub fn next_stdout_line(&mut self) -> String {
        let line = next_line(&self.stdout, self.deadline).expect("it ended without a line");
        self.said_on_stdout.push_str(&line);
        line
    }

    /// Writes a line to its standard input.
    pub fn say(&mut self, line: &str) {
        writeln!(self.stdin.as_mut().unwrap(), "{line}").unwrap();
    }

    /// Sends a signal, as Ctrl-C (`INT`) or a shutdown (`TERM`) does.
    pub fn signal(&self, name: &str) {
        let status = Command::new("kill")
            .args([format!("-{name}"), self.child.id().to_string()])
            .status()
            .unwrap();
        assert!(status.success());
    }

    /// Closes its standard input.
    pub fn close_stdin(&mut self) {
        self.stdin = None;
    }

    /// Waits for its end, and that of every child that shares its outputs.
    #[track_caller]
    pub fn end(mut self) -> Ended {
        while let Some(line) = next_line(&self.stderr, self.deadline) {
            self.said_on_stderr.push_str(&line);
        }
        while let Some(line) = next_line(&self.stdout, self.deadline) {
            self.said_on_stdout.push_str(&line);
        }
        let status = self.child.wait().unwrap();
        Ended {
            // No code: ended by a signal.
            code: status.code().unwrap_or(-1),
            stdout: std::mem::take(&mut self.said_on_stdout),
            stderr: std::mem::take(&mut self.said_on_stderr),
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// A simulated device or cell that a test has started by itself.
pub struct Simulator {
    process: Process,
    ready: Value,
}

impl Simulator {
    /// `sim cell`, `sim robot` or `sim camera`, listening on free ports.
    pub fn start(bench: &Bench, device: &str, options: &[&str]) -> Self {
        let mut words = vec!["sim", device, "--json", "--until-stdin-closes"];
        words.extend(options);
        let mut process = bench.start(&words);
        let ready = serde_json::from_str(&process.next_stdout_line()).unwrap();
        Self { process, ready }
    }

    /// What it says of one of its links.
    pub fn ready(&self, link: &str) -> &str {
        self.ready[link]
            .as_str()
            .unwrap_or_else(|| panic!("no {link} in {}", self.ready))
    }

    /// Where its robot listens.
    pub fn robot(&self) -> &str {
        self.ready["hses"].as_str().unwrap()
    }

    /// Where its camera listens.
    pub fn camera(&self) -> &str {
        self.ready["a3dp"].as_str().unwrap()
    }

    /// Stops its process without ending it: everything that it is sent stays unanswered.
    pub fn freeze(&self) {
        self.process.signal("STOP");
    }

    /// Kills its process.
    pub fn kill(&self) {
        self.process.signal("KILL");
    }

    /// Closes its standard input and waits for its end.
    pub fn stop(mut self) -> Ended {
        self.process.close_stdin();
        self.process.end()
    }
}

/// The simulated station at given addresses, with short time-outs.
pub fn station(robot: &str, camera: &str) -> String {
    let text = Station::BUILTIN_SIMULATED_TEXT;
    let robot_keys = format!("[robot]\naddress = \"{robot}\"\nanswer_timeout_ms = 100\nhold_timeout_ms = 300");
    let camera_keys = format!(
        "[camera]\naddress = \"{camera}\"\nping_interval_ms = 200\ndead_after_ms = 1000\nreconnect_timeout_ms = 1000\n"
    );
    let with_robot = text.replace("[robot]", &robot_keys);
    assert_ne!(with_robot, text);
    with_robot + "\n" + &camera_keys
}

/// An address where nothing listens: its port is privileged, so no other test is ever given it.
pub const CLOSED: &str = "127.0.0.1:1";

fn lines(pipe: impl std::io::Read + Send + 'static) -> Receiver<String> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let mut reader = BufReader::new(pipe);
        let mut line = Vec::new();
        // Bytes, not text: what is not UTF-8 must be seen, not end the reading.
        while matches!(reader.read_until(b'\n', &mut line), Ok(length) if length > 0) {
            let text = String::from_utf8_lossy(&line).into_owned();
            line.clear();
            if sender.send(text).is_err() {
                // The test has failed; the pipe must not fill up.
                reader.read_to_end(&mut line).ok();
            }
        }
    });
    receiver
}

/// The next line; none at the end.
#[track_caller]
fn next_line(lines: &Receiver<String>, deadline: Instant) -> Option<String> {
    match lines.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
        Ok(line) => Some(line),
        Err(RecvTimeoutError::Disconnected) => None,
        Err(RecvTimeoutError::Timeout) => panic!("the deadline of {PATIENCE:?} has passed"),
    }
}

/// How long one program may take, on a machine with much else to do.
const PATIENCE: Duration = Duration::from_secs(120);
