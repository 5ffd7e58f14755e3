//! Greetings, roles and goodbyes (sections 3.1, 3.3, 3.4, 3.6, 4.1 to 4.3).

use super::bench::{Bench, REPLY_MS, arm, bye, hello, is_error, require, trigger, unexpected};
use super::framing::ends_with_bye;
use super::states::reads;
use super::{Clause, Miss, Needs, clause};
use crate::camera::lines::{LineId, server_message};
use crate::camera::message::{
    Bye, CameraState, Caps, ClientMessage, ComponentKind, Greeting, Hello, ServerMessage, TRIGGER_ALL, TriggerId,
};

pub(super) const CLAUSES: &[Clause] = &[
    clause(
        Needs::Nothing,
        "3.1-before-hello",
        "before HELLO every message but HELLO and BYE gets ERROR 205, and the connection stays open",
        "every request before HELLO, then HELLO",
        before_hello,
    ),
    clause(
        Needs::Nothing,
        "4-unknown-type",
        "an unknown type gets ERROR 106, and the connection stays open",
        "a frame of type 0x0999, then GET_STATUS",
        |bench| {
            let line = bench.controller()?;
            let frame = bench.lines.raw_frame(line, 0x0999, 90, 0, &[1, 2, 3]);
            bench.lines.send(line, frame);
            is_error(&bench.lines.reply(line, 90, "ERROR 106", REPLY_MS)?, 106)?;
            bench.state(line).map(|_| ())
        },
    ),
    clause(
        Needs::Nothing,
        "4.1-version",
        "a server that speaks none of the versions answers ERROR 105 and BYE 3",
        "HELLO for versions 2.0 to 3.0",
        |bench| {
            let run_id = bench.new_run();
            let greeting = Hello {
                min_version: [2, 0],
                max_version: [3, 0],
                ..hello(run_id)
            };
            let line = refused_hello(bench, &greeting, 105)?;
            ends_with_bye(bench, line, Bye::PROTOCOL)
        },
    ),
    clause(
        Needs::Nothing,
        "4.1-version-range",
        "a server that speaks one of the versions takes it",
        "HELLO for versions 1.0 to 2.7",
        |bench| {
            let run_id = bench.new_run();
            let greeting = Hello {
                max_version: [2, 7],
                ..hello(run_id)
            };
            let (_, answer) = bench.greet(&greeting)?;
            require(answer.version == [1, 0], || {
                format!("version {:?} was chosen", answer.version)
            })
        },
    ),
    clause(
        Needs::Nothing,
        "4.1-role",
        "a role other than 1 and 2: ERROR 301",
        "HELLO with role 3",
        |bench| {
            let run_id = bench.new_run();
            refused_hello(
                bench,
                &Hello {
                    role: 3,
                    ..hello(run_id)
                },
                301,
            )
            .map(|_| ())
        },
    ),
    clause(
        Needs::Nothing,
        "4.1-run-id",
        "a controller's run id is not 0: ERROR 301",
        "HELLO as a controller with run id 0",
        |bench| refused_hello(bench, &hello(0), 301).map(|_| ()),
    ),
    clause(
        Needs::Nothing,
        "4.1-name",
        "the client's name has 1 to 64 bytes, else ERROR 301",
        "HELLO with no name, with 65 bytes, and with 64 bytes",
        |bench| {
            for length in [0, 65] {
                let run_id = bench.new_run();
                let client_name = "n".repeat(length);
                refused_hello(
                    bench,
                    &Hello {
                        client_name,
                        ..hello(run_id)
                    },
                    301,
                )?;
            }
            let run_id = bench.new_run();
            let client_name = "n".repeat(64);
            bench
                .greet(&Hello {
                    client_name,
                    ..hello(run_id)
                })
                .map(|_| ())
        },
    ),
    clause(
        Needs::Nothing,
        "4.2-greeting",
        "HELLO_OK names version 1.0, the role, limits within the page's, a clock of 1 GHz, and who it is",
        "HELLO as a controller and as an observer; boot ids and sessions compared",
        |bench| {
            let run_id = bench.new_run();
            let (_, first) = bench.greet(&hello(run_id))?;
            let (_, second) = bench.greet(&Hello::observer(super::NAME))?;
            fits_the_page(&first, Hello::CONTROLLER)?;
            fits_the_page(&second, Hello::OBSERVER)?;
            require(first.boot_id == second.boot_id, || {
                "the boot id has changed between two connections".into()
            })?;
            require(first.session_id != second.session_id, || {
                "two connections have one session id".into()
            })
        },
    ),
    clause(
        Needs::Nothing,
        "4.3-caps",
        "CAPS holds ranges that can be met: least, usual and greatest in order, MASK and XYZ or RANGE offered",
        "GET_CAPS",
        |bench| caps_make_sense(&bench.context.caps),
    ),
    clause(
        Needs::Nothing,
        "3.4-second-controller",
        "a second controller gets ERROR 201 whose text names the holder, then BYE 5, and is closed",
        "HELLO of another run while a controller is connected",
        |bench| {
            let holder = bench.controller()?;
            let run_id = bench.new_run();
            let line = refused_hello(bench, &hello(run_id), 201)?;
            ends_with_bye(bench, line, Bye::REFUSED)?;
            bench.state(holder).map(|_| ())
        },
    ),
    clause(
        Needs::Nothing,
        "3.4-observer",
        "an observer may GET_CAPS, GET_STATUS and PING; anything else gets 207, and the connection stays open",
        "every request on an observer's connection",
        observer_only_reads,
    ),
    clause(
        Needs::Nothing,
        "3.4-observers",
        "three observers are served beside a controller; a fourth gets ERROR 201 and BYE 5",
        "one controller and four observers",
        |bench| {
            bench.controller()?;
            for _ in 0..3 {
                bench.observer()?;
            }
            let line = refused_hello(bench, &Hello::observer(super::NAME), 201)?;
            ends_with_bye(bench, line, Bye::REFUSED)
        },
    ),
    clause(
        Needs::Device,
        "4.14-config-changed",
        "an observer hears EVENT 6 when the controller has configured",
        "CONFIGURE while an observer listens",
        |bench| {
            let observer = bench.observer()?;
            let line = bench.controller()?;
            let settings = bench.context.small;
            bench.configure(line, &settings)?;
            bench.lines.pass(EVENT_MS);
            let heard = bench.lines.line(observer).events().iter().any(|event| event.code == 6);
            require(heard, || {
                format!("no EVENT 6 came to the observer within {EVENT_MS} ms")
            })
        },
    ),
    clause(
        Needs::Nothing,
        "3.3-replaced",
        "a HELLO with the run id of the connected controller takes its place; the older connection gets BYE 6",
        "HELLO twice with one run id, from two connections",
        |bench| {
            let run_id = bench.new_run();
            let (older, _) = bench.greet(&hello(run_id))?;
            let (newer, _) = bench.greet(&hello(run_id))?;
            ends_with_bye(bench, older, Bye::REPLACED)?;
            bench.is_in(newer, CameraState::Idle)
        },
    ),
    clause(
        Needs::Nothing,
        "3.6-bye",
        "a BYE is not answered by another; after it both close",
        "BYE from a controller and from an observer",
        |bench| {
            for line in [bench.controller()?, bench.observer()?] {
                bench.lines.say(line, &bye());
                require(bench.lines.is_closed_within(line, REPLY_MS), || {
                    "the server did not close".into()
                })?;
                require(bench.lines.line(line).goodbye().is_none(), || {
                    "the server answered BYE with BYE".into()
                })?;
            }
            Ok(())
        },
    ),
    clause(
        Needs::Nothing,
        "3.6-closed",
        "when a controller's connection ends without a word, its place is free",
        "a controller's connection is closed; a controller of another run greets",
        |bench| {
            let line = bench.controller()?;
            bench.lines.close(line);
            bench.controller().map(|_| ())
        },
    ),
];

/// A connection whose HELLO must be refused with this code.
fn refused_hello(bench: &mut Bench<'_, '_>, greeting: &Hello, code: u16) -> Result<LineId, Miss> {
    let line = bench.connect()?;
    let error = bench.refused(line, &ClientMessage::Hello(greeting.clone()), code)?;
    let names_holder = code != 201 || greeting.role != Hello::CONTROLLER || error.text.contains(super::NAME);
    require(names_holder, || {
        format!("the text does not name the holder, {:?}: {:?}", super::NAME, error.text)
    })?;
    Ok(line)
}

/// Requests that a controller may say and that do nothing in IDLE without settings.
fn controllers_requests(bench: &Bench<'_, '_>) -> Vec<ClientMessage> {
    vec![
        ClientMessage::Configure(bench.context.small),
        arm(1),
        ClientMessage::Disarm,
        trigger(bench.trigger_id(0), 1, 0),
        ClientMessage::Fetch {
            trigger_id: TriggerId(0),
        },
        ClientMessage::Abort {
            trigger_id: TRIGGER_ALL,
        },
    ]
}

fn before_hello(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let line = bench.connect()?;
    let mut requests = controllers_requests(bench);
    requests.extend([
        ClientMessage::GetCaps,
        ClientMessage::GetStatus,
        ClientMessage::Ping { sender_ns: 1 },
    ]);
    for request in &requests {
        bench.refused(line, request, 205)?;
    }
    let greeting = ClientMessage::Hello(Hello::observer(super::NAME));
    let heard = bench.ask(line, &greeting)?;
    match server_message(&heard)? {
        ServerMessage::HelloOk(_) => Ok(()),
        _ => Err(unexpected("HELLO_OK after the refusals", &heard)),
    }
}

fn observer_only_reads(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let line = bench.observer()?;
    for request in controllers_requests(bench) {
        bench.refused(line, &request, 207)?;
    }
    reads(bench, line)
}

fn fits_the_page(greeting: &Greeting, role: u8) -> Result<(), Miss> {
    // Version and frame_bytes_max are checked where the message is read.
    require(greeting.role == role, || format!("role {} for {role}", greeting.role))?;
    require(greeting.clock_hz == 1_000_000_000, || {
        format!("clock_hz {}", greeting.clock_hz)
    })?;
    require(greeting.boot_id != 0, || "boot id 0".into())?;
    require(greeting.control_payload_max <= 65_536, || {
        format!("control_payload_max {}", greeting.control_payload_max)
    })?;
    require((1..=1_048_576).contains(&greeting.chunk_payload_max), || {
        format!("chunk_payload_max {}", greeting.chunk_payload_max)
    })?;
    let date = greeting.calibration_date;
    let is_date = (1..=12).contains(&(date / 100 % 100)) && (1..=31).contains(&(date % 100));
    require(date == 0 || is_date, || format!("calibration_date {date} is no date"))?;
    require(!greeting.model.is_empty(), || "the model is not named".into())
}

fn caps_make_sense(caps: &Caps) -> Result<(), Miss> {
    let ascend = |name: &str, values: [f64; 3]| {
        require(values[0] <= values[1] && values[1] <= values[2], || {
            format!("{name} are {values:?}")
        })
    };
    let exposures = [caps.exposure_min_us, caps.exposure_default_us, caps.exposure_max_us];
    ascend("exposures", exposures.map(f64::from))?;
    let images = [caps.image_count_min, caps.image_count_default, caps.image_count_max];
    ascend("image counts", images.map(f64::from))?;
    ascend("working distances", caps.working_distance_mm.map(f64::from))?;
    for axis in 0..2 {
        let (sensor, least, step) = (caps.sensor_px[axis], caps.roi_min_px[axis], caps.roi_step_px[axis]);
        require(step > 0 && least > 0 && least <= sensor, || {
            format!("a sensor of {sensor} px takes no region of {least} px in steps of {step} px")
        })?;
    }
    let points = ComponentKind::Xyz.bit() | ComponentKind::Range.bit();
    require(
        caps.components & ComponentKind::Mask.bit() != 0 && caps.components & points != 0,
        || format!("components {:#b} lack MASK, or XYZ and RANGE", caps.components),
    )?;
    require((1..=100).contains(&caps.led_max_percent), || {
        format!("led_max_percent {}", caps.led_max_percent)
    })?;
    for (name, mask, known) in [
        ("outlier_filters", caps.outlier_filters, 0b1111),
        ("compressions", caps.compressions, 0b1111),
        ("working_volumes", caps.working_volumes, 0b11),
    ] {
        require(mask != 0 && mask & !known == 0, || format!("{name} {mask:#b}"))?;
    }
    require(caps.spacing_mm > 0.0, || format!("spacing_mm {}", caps.spacing_mm))
}

const EVENT_MS: u64 = 2000;
