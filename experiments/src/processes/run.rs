//! One run: begun, killed some times, resumed until it ends.

use super::Results;
use super::judge::{Snapshot, Tally, Wrong, judge};
use super::proxy::Proxy;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

type Failure = Box<dyn std::error::Error>;

/// Where a run takes place.
enum Place {
    /// The program's own simulated cell, which dies with it: a power cut.
    Own,
    /// A cell that lives on when the program is killed.
    Apart { cell: Child, proxy: Proxy },
}

/// The results of the run that nothing interrupts.
pub(super) fn unbroken(program: &Path, root: &Path) -> Result<Results, Failure> {
    let folder = root.join("unbroken");
    std::fs::create_dir_all(&folder)?;
    std::fs::write(folder.join("tiny.toml"), RECIPE)?;
    let mut child = start(program, &folder, &dry_run("out"))?;
    let status = wait(&mut child, RUN_MAX)?.ok_or("the unbroken run does not end")?;
    if !status.success() {
        return Err("the unbroken run failed".into());
    }
    Ok(Results::read(&folder.join("out"))?)
}

/// Carries one run out and says what was wrong.
pub(super) fn carry_out(
    program: &Path,
    root: &Path,
    seed: u64,
    unbroken: &Results,
    tally: &mut Tally,
) -> Result<Vec<Wrong>, Failure> {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let folder = root.join(format!("run-{seed}"));
    std::fs::create_dir_all(&folder)?;
    std::fs::write(folder.join("tiny.toml"), RECIPE)?;
    let mut place = if chance.random() {
        Place::Own
    } else {
        apart(program, &folder)?
    };
    let kill_count = chance.random_range(1..=KILLS_MAX);
    let mut wrongs = Vec::new();
    let mut snapshot = Snapshot::default();
    let mut out = "out".to_owned();
    let mut goes_on = false;
    for part in 0..=kill_count {
        let words = match (goes_on, &place) {
            (true, Place::Own) => strings(&["resume", &out]),
            (true, Place::Apart { .. }) => strings(&["resume", &out, "--arm"]),
            (false, Place::Own) => dry_run(&out),
            (false, Place::Apart { .. }) => {
                let words = [
                    "run",
                    "tiny.toml",
                    "--station",
                    "cell.toml",
                    "--arm",
                    "--views",
                    VIEWS,
                    "--out",
                    &out,
                ];
                strings(&words)
            }
        };
        let mut child = start(program, &folder, &words)?;
        let patience = match part < kill_count {
            true => Duration::from_millis(chance.random_range(0..KILL_MS_MAX)),
            false => RUN_MAX,
        };
        let ended = wait(&mut child, patience)?;
        if ended.is_none() {
            child.kill()?;
            child.wait()?;
        }
        match ended {
            None if part < kill_count => tally.kill_count += 1,
            None => wrongs.push(Wrong(format!("`{}` has not ended after {RUN_MAX:?}", words.join(" ")))),
            Some(status) if status.success() => break,
            Some(status) => {
                let said = std::fs::read_to_string(folder.join("said.txt")).unwrap_or_default();
                let last = said.lines().rev().take(8).collect::<Vec<_>>().join(" | ");
                wrongs.push(Wrong(format!("`{}` ended with {status}: {last}", words.join(" "))));
                break;
            }
        }
        let recording = folder.join(&out).join("run.mcap");
        goes_on = snapshot.take(&recording);
        if !goes_on {
            tally.unbegun_count += 1;
            out = format!("out-{}", part + 1);
        }
    }
    let passed = match &place {
        Place::Own => Vec::new(),
        Place::Apart { proxy, .. } => proxy.passed(),
    };
    place.end()?;
    wrongs.extend(judge(&folder.join(&out), &snapshot, &passed, unbroken, tally)?);
    let mut replay = start(program, &folder, &strings(&["replay", &format!("{out}/run.mcap")]))?;
    if !wait(&mut replay, RUN_MAX)?.is_some_and(|status| status.success()) {
        wrongs.push(Wrong("the recording does not replay".into()));
    }
    if wrongs.is_empty() {
        std::fs::remove_dir_all(&folder)?;
    }
    Ok(wrongs)
}

impl Place {
    fn end(&mut self) -> Result<(), Failure> {
        if let Self::Apart { cell, .. } = self {
            drop(cell.stdin.take());
            wait(cell, RUN_MAX)?;
        }
        Ok(())
    }
}

fn apart(program: &Path, folder: &Path) -> Result<Place, Failure> {
    let mut cell = Command::new(program)
        .args([
            "sim",
            "cell",
            "--json",
            "--until-stdin-closes",
            "--blade=builtin:hpt-a",
            "--optics=fine",
        ])
        .args([&format!("--speed={SPEED}"), "--truth=truth.json"])
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut line = String::new();
    BufReader::new(cell.stdout.take().ok_or("no output")?).read_line(&mut line)?;
    let ready: Value = serde_json::from_str(&line)?;
    let address = |link: &str| ready[link].as_str().ok_or("the cell has no such link");
    let robot: SocketAddr = address("hses")?.parse()?;
    let proxy = Proxy::start(robot)?;
    let text = bladescan::settings::Station::BUILTIN_SIMULATED_TEXT;
    let with_robot = text.replace("[robot]", &format!("[robot]\naddress = \"{}\"", proxy.address));
    let station = format!("{with_robot}\n[camera]\naddress = \"{}\"\n", address("a3dp")?);
    std::fs::write(folder.join("cell.toml"), station)?;
    Ok(Place::Apart { cell, proxy })
}

fn dry_run(out: &str) -> Vec<String> {
    strings(&["dry-run", "tiny.toml", "--views", VIEWS, "--speed", SPEED, "--out", out])
}

fn strings(words: &[&str]) -> Vec<String> {
    words.iter().map(|&word| word.to_owned()).collect()
}

fn start(program: &Path, folder: &Path, words: &[String]) -> Result<Child, Failure> {
    let said = std::fs::File::create(folder.join("said.txt"))?;
    Ok(Command::new(program)
        .args(words)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(said)
        .spawn()?)
}

/// The child's end; `None` if it does not end in that time.
fn wait(child: &mut Child, patience: Duration) -> Result<Option<ExitStatus>, Failure> {
    let begun = Instant::now();
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if begun.elapsed() >= patience {
            return Ok(None);
        }
        std::thread::sleep(TURN);
    }
}

const VIEWS: &str = "4";
const SPEED: &str = "50";
const KILLS_MAX: u32 = 3;
/// About as long as a run takes.
const KILL_MS_MAX: u64 = 4000;
/// The bound of every part: a run of four views, or a resume of it, on a busy machine.
const RUN_MAX: Duration = Duration::from_secs(120);
const TURN: Duration = Duration::from_millis(2);
const RECIPE: &str = r#"name = "tiny"
[blade]
cad = "builtin:hpt-a"
[views]
step_deg = 10.0
views_min = 4
[presentation]
position_mm = [0.0, 0.0, 280.0]
rotation_deg = [0.0, 90.0, 0.0]
[camera]
optics = "fine"
roi_px = [240, 160, 600, 460]
points_min = 500
[merge]
overlap_min_fraction = 0.5
"#;
