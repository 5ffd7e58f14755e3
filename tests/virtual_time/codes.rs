//! Every code of `docs/faults.md` is reached, here or by the test that is named here.

use super::*;
use crate::support::{CLOSED, station};
use bladescan::fault::FaultCode;
use std::path::Path;

/// How a code is reached.
enum Way {
    /// This run ends by it.
    Run(Box<Pair>),
    /// The test of this name in this file, which names the code.
    Test(&'static str, &'static str),
}

fn with_faults(faults: &[&str]) -> Way {
    Way::Run(Box::new(Pair::new(4, faults, 0.0, 1)))
}

/// A run at a station whose text has `to` in the place of `from`.
fn at_station(from: &str, to: &str, faults: &[&str], loss: f64) -> Way {
    let text = station(CLOSED, CLOSED);
    assert!(text.contains(from), "{from} is not in {text}");
    let texts = (RECIPE, &*text.replace(from, to));
    Way::Run(Box::new(Pair::at_station(texts.0, texts.1, 4, faults, loss, 1)))
}

/// A run in which `input` comes so many times in a row.
fn with_input(at_ns: u64, count: u64, input: &Input) -> Way {
    let mut pair = Pair::new(4, &[], 0.0, 1);
    for _ in 0..count {
        pair.send(at_ns, Delivery::ToController(input.clone()));
    }
    Way::Run(Box::new(pair))
}

fn reason(text: &str) -> String {
    text.to_owned()
}

fn way(code: FaultCode) -> Way {
    let no_reconnecting = "reconnect_timeout_ms = 1000";
    let never = "reconnect_timeout_ms = 0";
    let (simulated, real) = ("kind = \"simulated\"", "kind = \"cell\"");
    let robot = "[robot]";
    match code {
        FaultCode::RobotUnreachable => {
            let reason = reason("refused");
            with_input(1_000_000_000, 1, &Input::RobotUnreachable { reason })
        }
        FaultCode::RobotSilent => with_faults(&["robot-silent@1"]),
        FaultCode::RobotGarbled => with_input(1_000, 3, &Input::RobotBytes(b"no answer".to_vec())),
        FaultCode::RobotAlarm => with_faults(&["robot-alarm=4315@1"]),
        FaultCode::RobotNotRemote => with_faults(&["remote-off"]),
        FaultCode::RobotServo => with_faults(&["estop@1"]),
        FaultCode::RobotRefused => with_faults(&["busy=1000@0"]),
        FaultCode::RobotElsewhere => with_faults(&["elsewhere=3@1"]),
        FaultCode::RobotLate => at_station(robot, "[robot]\nmove_timeout_ms = 100", &[], 0.0),
        FaultCode::RobotNotHeld => {
            let Way::Run(mut pair) = at_station(robot, robot, &[], 0.0) else {
                unreachable!("a run was made");
            };
            pair.send(2_000_000_000, Delivery::ToPanel(Panel::Power(false)));
            pair.send(2_000_000_001, Delivery::ToController(Input::Operator(Command::Hold)));
            Way::Run(pair)
        }
        FaultCode::RobotJob => at_station(robot, "[robot]\nmotion = \"job\"\njob.name = \"NOSUCH\"", &[], 0.0),
        FaultCode::RobotIdentity => at_station(simulated, real, &[], 0.0),
        FaultCode::CameraUnreachable => {
            let reason = reason("refused");
            with_input(1_000, 1, &Input::CameraClosed { reason })
        }
        FaultCode::CameraLost => at_station(no_reconnecting, never, &["camera-gone@1"], 0.0),
        FaultCode::CameraSilent => at_station(no_reconnecting, never, &["camera-silent@1"], 0.0),
        FaultCode::CameraProtocol => at_station(no_reconnecting, never, &["corrupt-payload@1"], 0.0),
        FaultCode::CameraSettings => with_faults(&["config-echo"]),
        FaultCode::CameraRefused => with_faults(&["controller-busy"]),
        FaultCode::CameraNotReady => with_faults(&["camera-broken@1:exposure"]),
        FaultCode::CameraFailing => with_faults(&[
            "camera-error=405@1",
            "camera-error=405@1.1",
            "camera-error=405@1.2",
            "camera-error=405@2",
            "camera-error=405@2.1",
        ]),
        FaultCode::CameraOptics => {
            let text = RECIPE.replace("\"fine\"", "\"medium\"");
            Way::Run(Box::new(Pair::with_recipe(&text, 4, &[], 0.0, 1)))
        }
        // The robot does not come to say that it is simulated.
        FaultCode::CameraIdentity => at_station(simulated, real, &[], 1.0),
        FaultCode::BladeMoved => Way::Test(
            "tests/virtual_time/restart.rs",
            "a_blade_that_sits_where_it_sat_passes_and_one_that_has_moved_stops_the_run",
        ),
        FaultCode::Journal => {
            let reason = reason("full");
            with_input(2_000_000_000, 1, &Input::JournalFailed { reason })
        }
        FaultCode::JobPanicked => {
            let mut pair = Pair::new(4, &[], 0.0, 1);
            pair.panicking_job = Some(("register", 1));
            Way::Run(Box::new(pair))
        }
    }
}

/// The run ends by the code and leaves what the operator and those who look for the cause need; otherwise, how it ended.
fn ends_by(code: FaultCode, mut pair: Pair) -> Result<(), String> {
    let name = code.name();
    let ending = pair.drive(|_| None);
    if Pair::fault_name(&ending) != name {
        return Err(format!("{name}: {ending:?}"));
    }
    let left: serde_json::Value = serde_json::from_slice(&pair.files["fault.json"]).unwrap();
    assert_eq!(left["fault"]["code"], name);
    assert_eq!(left["remedy"], code.remedy());
    assert_eq!(left["way_back"], serde_json::to_value(code.way_back()).unwrap());
    let exchanges = left["exchanges"].as_array().unwrap();
    assert!((1..=128).contains(&exchanges.len()), "{name}: {}", exchanges.len());
    let at_s = left["at_s"].as_f64().unwrap();
    assert!(
        exchanges.iter().all(|one| one["at_s"].as_f64().unwrap() <= at_s),
        "{name}"
    );
    if code != FaultCode::JobPanicked {
        // On replay the job does not panic.
        pair.replay();
    }
    Ok(())
}

#[test]
fn every_code_ends_a_run_or_is_reached_by_a_test_that_is_named_here() {
    let mut wrong = Vec::new();
    for code in FaultCode::ALL {
        match way(code) {
            Way::Run(pair) => wrong.extend(ends_by(code, *pair).err()),
            Way::Test(file, test) => {
                let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
                let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{file}: {error}"));
                let body = text.split(&format!("fn {test}()")).nth(1);
                let body = body.unwrap_or_else(|| panic!("{file} has no test {test}"));
                let body = body.split("#[test]").next().unwrap();
                let variant = format!("{code:?}");
                assert!(
                    body.contains(code.name()) || body.contains(&variant),
                    "{test} does not name {variant}"
                );
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn what_a_fault_leaves_says_where_in_the_run_it_came_and_names_what_was_said() {
    let mut pair = Pair::new(3, &["robot-alarm=4315@1"], 0.0, 1);
    pair.drive(|_| None);
    let left: serde_json::Value = serde_json::from_slice(&pair.files["fault.json"]).unwrap();
    assert_eq!(
        (&left["state"], &left["view_index"], &left["attempt"]),
        (&"moving".into(), &1.into(), &0.into())
    );
    assert_eq!(left["run"]["recipe"]["name"], "small");
    let exchanges = left["exchanges"].as_array().unwrap();
    let said = |device: &str, message: &str| {
        let is_it = |one: &&serde_json::Value| one["device"] == device && one["message"] == message;
        exchanges.iter().filter(is_it).count()
    };
    for (device, message) in [
        ("robot", "status"),
        ("robot", "answer: status"),
        ("robot", "alarm"),
        ("camera", "TRIGGER"),
        ("camera", "FRAME_CHUNK"),
        ("camera", "FRAME_END"),
    ] {
        assert!(said(device, message) > 0, "{device} {message}: {exchanges:#?}");
    }
    assert_eq!(said("robot", "another command"), 0);
    let alarm = exchanges.iter().rfind(|one| one["message"] == "answer: alarm").unwrap();
    assert_eq!(alarm["first_bytes_hex"].as_str().unwrap().len(), 96);
    pair.replay();
}

#[test]
fn a_run_that_ends_well_or_by_the_operator_leaves_no_fault() {
    for last in [None, Some(Command::Abort)] {
        let mut pair = Pair::new(2, &[], 0.0, 1);
        pair.drive(|event| last.filter(|_| matches!(event, Event::RobotReady)));
        assert!(!pair.files.contains_key("fault.json"));
        pair.replay();
    }
}

#[test]
fn what_is_never_answered_is_silence_and_no_fault_of_the_servo() {
    let mut pair = Pair::new(1, &[], 0.0, 1);
    pair.lost_command = Some(robot::Command::ServoOn);
    let Ending::Faulted { fault } = pair.drive(|_| None) else {
        panic!("{:#?}", pair.events);
    };
    assert_eq!(
        (fault.code, fault.seen.as_str()),
        (FaultCode::RobotSilent, "servo on: never answered")
    );
    pair.replay();
}
