//! `bladescan camera bridge` as a program, with a simulated vendor's side as its child, over a socket.

use crate::support::Bench;
use bladescan::camera::{
    Arm, Assembly, Bye, CameraSettings, CameraState, Capture, ClientMessage, ComponentKind, DeviceEvent, FetchState,
    FrameReader, FrameWriter, Hello, ServerMessage, Trigger, TriggerId,
};
use hw_sim::vendor::{Args, Layout, serve};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::path::PathBuf;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

const PROGRAM: &str = env!("CARGO_BIN_EXE_bladescan");
const DEADLINE: Duration = Duration::from_secs(30);
const RUN: u64 = 77;
const SETTINGS: CameraSettings = CameraSettings {
    binning: false,
    roi_px: [160, 120, 640, 480, 640, 480],
    exposure_us: 1000,
    image_count: 24,
    hdr_us: [0, 0],
    compression: 1,
    led_percent: 25,
    frame_time_ratio: 2.0,
    score_threshold: 0.85,
    outlier_filter: 1,
    reconstruction_quality: 5,
    pre_filtering: 3,
    working_volume: 1,
    volume_of_interest: None,
    components: ComponentKind::WANTED,
};

/// A running bridge; it ends with the test, and its vendor's side with it.
struct Bridge {
    child: Child,
    said: BufReader<ChildStdout>,
}

impl Bridge {
    /// The vendor's z points towards the camera, in units of 10 mm.
    fn start(bench: &Bench, vendor: &str) -> Self {
        let config = format!(
            "listen = '127.0.0.1:0'\n\
             [vendor]\n{vendor}\nframes = 'frames'\n\
             [camera]\noptics = 'fine'\nworking_distance_mm = [200.0, 260.0, 320.0]\nspacing_mm = 0.04\n\
             [axes]\nunit_mm = 10.0\n\
             camera_from_vendor = [[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 5000.0]]\n"
        );
        bench.write("bridge.toml", config);
        let mut child = Command::new(PROGRAM)
            .args(["camera", "bridge", "bridge.toml", "--json"])
            .current_dir(bench.path(""))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let said = BufReader::new(child.stdout.take().unwrap());
        Self { child, said }
    }

    /// With a child as the vendor's side, which gives its frames in that layout.
    fn with_child(bench: &Bench, layout: &str) -> Self {
        let command = format!("command = ['{PROGRAM}', 'sim', 'vendor', '--layout={layout}', 'frames']");
        Self::start(bench, &command)
    }

    /// The address that the next line gives.
    fn address(&mut self, name: &str) -> SocketAddr {
        let mut line = String::new();
        self.said.read_line(&mut line).unwrap();
        let said: serde_json::Value = serde_json::from_str(&line).unwrap();
        said[name].as_str().unwrap().parse().unwrap()
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

struct Client {
    stream: TcpStream,
    reader: FrameReader,
    writer: FrameWriter,
    next_request_id: u32,
}

impl Client {
    fn greet(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(DEADLINE)).unwrap();
        let mut client = Self {
            stream,
            reader: FrameReader::default(),
            writer: FrameWriter::default(),
            next_request_id: 1,
        };
        client.say(&ClientMessage::Hello(Hello::controller(RUN, "tests")));
        client.until(|message| match message {
            ServerMessage::HelloOk(greeting) => {
                assert!(greeting.simulated);
                assert_eq!(
                    (greeting.model.as_str(), greeting.serial.as_str()),
                    ("simulated plane", "SIM-PLANE")
                );
                Some(())
            }
            _ => None,
        });
        client
    }

    fn say(&mut self, message: &ClientMessage) {
        let bytes = self
            .writer
            .write_with(message.kind(), self.next_request_id, 0, |payload| {
                message.encode(payload)
            });
        self.next_request_id += 1;
        self.stream.write_all(&bytes).unwrap();
    }

    /// Hears until `wanted` finds what it waits for; an ERROR is the end.
    fn until<T>(&mut self, mut wanted: impl FnMut(ServerMessage<'_>) -> Option<T>) -> T {
        let mut buffer = vec![0; 1 << 16];
        loop {
            while let Some(frame) = self.reader.next_frame().unwrap() {
                let message = ServerMessage::decode(frame.kind, frame.payload).unwrap().unwrap();
                assert!(!matches!(message, ServerMessage::Error(_)), "{message:?}");
                if let Some(found) = wanted(message) {
                    return found;
                }
            }
            let length = self
                .stream
                .read(&mut buffer)
                .expect("the bridge says something in time");
            assert!(length > 0, "the bridge has closed the connection");
            self.reader.push(&buffer[..length]);
        }
    }

    fn arm(&mut self) -> u32 {
        self.say(&ClientMessage::Configure(SETTINGS));
        let config_id = self.until(|message| match message {
            ServerMessage::Configured(configured) => {
                assert_eq!(
                    (configured.settings, configured.predicted_total_us),
                    (SETTINGS, 500_000)
                );
                Some(configured.config_id)
            }
            _ => None,
        });
        self.say(&ClientMessage::Arm(Arm {
            mode: Arm::SOFTWARE,
            config_id,
        }));
        self.until(|message| matches!(message, ServerMessage::Armed { .. }).then_some(()));
        config_id
    }

    fn trigger(&mut self, config_id: u32, view_index: u32) {
        let trigger_id = TriggerId::new(view_index, 0);
        self.say(&ClientMessage::Trigger(Trigger {
            trigger_id,
            view_id: view_index,
            config_id,
            deadline_ms: 0,
            tag: String::new(),
        }));
        self.until(|message| matches!(message, ServerMessage::TriggerOk(_)).then_some(()));
    }

    fn capture(&mut self) -> Capture {
        let mut assembly = None;
        self.until(|message| match message {
            ServerMessage::FrameBegin(begin) => {
                assembly = Some(Assembly::begin(*begin, 64 << 20).unwrap());
                None
            }
            ServerMessage::FrameChunk(chunk) => {
                assembly.as_mut().unwrap().push(&chunk).unwrap();
                None
            }
            ServerMessage::FrameEnd(end) => Some(assembly.take().unwrap().end(&end).unwrap()),
            _ => None,
        })
    }
}

/// Where the plane is in the camera frame: the vendor's units are 10 mm, its y and z point the other way.
fn expected(column: usize, row: usize) -> [f64; 3] {
    let (column, row) = (column as f64, row as f64);
    let value = 20_000.0 + 5.0 * column + 2.0 * row;
    let vendor = [0.25 * column - 90.0, 0.25 * row - 67.5, 0.0125 * value];
    [10.0 * vendor[0], -10.0 * vendor[1], 5000.0 - 10.0 * vendor[2]]
}

#[test]
fn frames_of_both_layouts_come_through_the_bridge_in_the_camera_frame() {
    for layout in ["esm", "range"] {
        let bench = Bench::new(&format!("bridge-{layout}"));
        let mut bridge = Bridge::with_child(&bench, layout);
        let mut client = Client::greet(bridge.address("a3dp"));
        let config_id = client.arm();
        for view_index in 0..2 {
            client.trigger(config_id, view_index);
            let capture = client.capture();
            assert_eq!((capture.width_px, capture.height_px), (160, 120));
            assert_eq!(capture.valid_count, 159 * 120);
            for (index, found) in capture.grid().points().enumerate() {
                let (column, row) = (index % 160, index / 160);
                let Some(found) = found else {
                    assert_eq!(column, 0, "{layout}: pixel {index}");
                    continue;
                };
                assert_ne!(column, 0, "{layout}: pixel {index}");
                for (found, expected) in found.iter().zip(expected(column, row)) {
                    assert!((f64::from(*found) - expected).abs() < 1e-3, "{layout}: pixel {index}");
                }
            }
            assert_eq!(capture.intensity.as_ref().unwrap()[161], 2);
        }
        let left = std::fs::read_dir(bench.path("frames")).unwrap().count();
        assert_eq!(left, 0, "files that were read are removed");
    }
}

#[test]
fn a_frame_is_fetched_after_the_connection_was_lost() {
    let bench = Bench::new("bridge-fetch");
    let mut bridge = Bridge::with_child(&bench, "esm");
    let address = bridge.address("a3dp");
    let mut client = Client::greet(address);
    let config_id = client.arm();
    client.trigger(config_id, 4);
    drop(client);
    // The frame lives on; how far it is when we are back is not in our hands.
    let mut back = Client::greet(address);
    back.say(&ClientMessage::Fetch {
        trigger_id: TriggerId::new(4, 0),
    });
    let state = back.until(|message| match message {
        ServerMessage::FetchOk(found) => Some(found.state),
        _ => None,
    });
    assert!(matches!(state, FetchState::InFlight | FetchState::Stored));
    assert_eq!(back.capture().trigger_id, TriggerId::new(4, 0));
    back.say(&ClientMessage::GetStatus);
    let state = back.until(|message| match message {
        ServerMessage::Status(status) => Some(status.state),
        _ => None,
    });
    assert_eq!(state, CameraState::Idle);
    back.say(&ClientMessage::Bye(Bye {
        reason: Bye::DONE,
        text: String::new(),
    }));
    back.stream
        .read_to_end(&mut Vec::new())
        .expect("the bridge closes the connection in time");
}

/// A vendor's side that connects, until the returned end is dropped.
fn vendor_connects(address: SocketAddr, folder: PathBuf) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    let (orders, answers) = (stream.try_clone().unwrap(), stream.try_clone().unwrap());
    let layout = Layout::Range;
    std::thread::spawn(move || serve(&Args { layout, folder }, BufReader::new(orders), answers));
    stream
}

#[test]
fn a_vendors_side_may_connect_go_and_come_back() {
    let bench = Bench::new("bridge-vendor-connects");
    let mut bridge = Bridge::start(&bench, "listen = '127.0.0.1:0'");
    let vendor_address = bridge.address("vendor");
    let vendor = vendor_connects(vendor_address, bench.path("frames"));
    let mut client = Client::greet(bridge.address("a3dp"));
    let config_id = client.arm();
    client.trigger(config_id, 0);
    assert_eq!(client.capture().valid_count, 159 * 120);
    let event = |message: ServerMessage<'_>, code| match message {
        ServerMessage::Event(event) => (event.code == code).then_some(()),
        _ => None,
    };
    vendor.shutdown(Shutdown::Both).unwrap();
    client.until(|message| event(message, DeviceEvent::DEVICE_LOST));
    let _vendor = vendor_connects(vendor_address, bench.path("frames"));
    client.until(|message| event(message, DeviceEvent::DEVICE_BACK));
    let config_id = client.arm();
    client.trigger(config_id, 1);
    assert_eq!(client.capture().valid_count, 159 * 120);
}
