use tokio::sync::oneshot;
use tokio_serial::SerialPortBuilderExt;

use super::*;
use crate::blade::Builtin;
use crate::camera::message::Message;
use crate::robot::host::bsc::{Contention, Link, LinkOutput, Message as BscMessage, Timing};
use crate::robot::ports::LinkOptions;
use crate::scene::Scene;
use crate::test_client::{Client, arm, configure, hello, small_settings, trigger};
use crate::vectors::{HSES_PAGE, vector};

const DEADLINE: Duration = Duration::from_secs(20);

fn within_deadline<T>(test: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        tokio::time::timeout(DEADLINE, test)
            .await
            .expect("the test is over in time")
    })
}

async fn receive_frame(stream: &mut TcpStream, client: &mut Client) -> Vec<Message> {
    let (mut messages, mut bytes) = (Vec::new(), vec![0; 65_536]);
    while !messages.iter().any(|message| matches!(message, Message::FrameEnd(_))) {
        let byte_count = stream.read(&mut bytes).await.unwrap();
        assert!(byte_count > 0, "the camera closed");
        messages.extend(
            client
                .read(&bytes[..byte_count])
                .into_iter()
                .map(|(_, message)| message),
        );
    }
    messages
}

#[test]
fn a_served_cell_answers_takes_a_frame_and_leaves_the_truth() {
    let path = std::env::temp_dir().join(format!("hw-sim-shell-{}.json", std::process::id()));
    within_deadline(async {
        let scene = Scene {
            speed: 100.0,
            ..Scene::default()
        };
        let renderer = Arc::new(Renderer::new(&Builtin::HptA.mesh(), scene.surface).unwrap());
        let sockets = Sockets::open(&Wanted {
            hses: Some(0),
            camera: Some(0),
            ..Wanted::default()
        })
        .await
        .unwrap();
        let (robot, camera) = (sockets.robot_address().unwrap(), sockets.camera_address().unwrap());
        let (stop, stopped) = oneshot::channel::<()>();
        let served = serve(Cell::new(scene), renderer, sockets, Some(path.clone()), async {
            stopped.await.unwrap()
        });
        let used = async {
            let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
            socket.send_to(&vector(HSES_PAGE, "req_hold_on"), robot).await.unwrap();
            let mut answer = [0; 512];
            let byte_count = socket.recv(&mut answer).await.unwrap();
            assert_eq!(answer[..byte_count], vector(HSES_PAGE, "ans_set_ok"));
            let (mut stream, mut client) = (TcpStream::connect(camera).await.unwrap(), Client::default());
            for message in [hello(), configure(&small_settings()), arm(1), trigger(4 << 16, 0)] {
                stream.write_all(&client.request(&message)).await.unwrap();
            }
            let messages = receive_frame(&mut stream, &mut client).await;
            assert!(matches!(messages[0], Message::HelloOk(_)));
            stop.send(()).unwrap();
            let mut rest = Vec::new();
            stream.read_to_end(&mut rest).await.unwrap();
            assert!(
                client
                    .read(&rest)
                    .iter()
                    .any(|(_, message)| matches!(message, Message::Bye(_)))
            );
        };
        let (served, ()) = tokio::join!(served, used);
        served.unwrap();
    });
    let truth: Truth = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert_eq!(
        truth.views.iter().map(|view| view.trigger_id).collect::<Vec<_>>(),
        [4 << 16]
    );
}

/// Everything up to an end: what comes in several pieces is put together.
async fn read_until(stream: &mut (impl AsyncReadExt + Unpin), end: &str) -> String {
    let mut text = String::new();
    while !text.ends_with(end) {
        let mut piece = [0; 256];
        let byte_count = stream.read(&mut piece).await.unwrap();
        assert!(byte_count > 0, "closed after {text:?}");
        text.push_str(&String::from_utf8_lossy(&piece[..byte_count]));
    }
    text
}

/// Serves a cell with host control and a serial line while `used` goes on.
fn with_host_links<T: Future<Output = ()>>(links: LinkOptions, used: impl FnOnce(SocketAddr, String) -> T) {
    within_deadline(async {
        let scene = Scene {
            links,
            ..Scene::default()
        };
        let renderer = Arc::new(Renderer::new(&Builtin::HptA.mesh(), scene.surface).unwrap());
        let sockets = Sockets::open(&Wanted {
            host_control: Some(0),
            has_serial: true,
            ..Wanted::default()
        })
        .await
        .unwrap();
        let address = sockets.host_control_address().unwrap();
        let used = used(address, sockets.serial_path().unwrap().to_owned());
        let (stop, stopped) = oneshot::channel::<()>();
        let served = serve(Cell::new(scene), renderer, sockets, None, async {
            stopped.await.unwrap()
        });
        let used = async {
            used.await;
            stop.send(()).unwrap();
        };
        let (served, ()) = tokio::join!(served, used);
        served.unwrap();
    });
}

#[test]
fn two_clients_of_host_control_are_served_at_once() {
    with_host_links(LinkOptions::default(), |address, _| async move {
        let mut first = TcpStream::connect(address).await.unwrap();
        let mut second = TcpStream::connect(address).await.unwrap();
        for stream in [&mut first, &mut second] {
            stream
                .write_all(b"CONNECT Robot_access Keep-Alive:2\r\n")
                .await
                .unwrap();
            let greeting = read_until(stream, "\r\n").await;
            assert!(
                greeting.starts_with("OK: DX Information Server(SIMULATED "),
                "{greeting}"
            );
        }
        first.write_all(b"HOSTCTRL_REQUEST SVON 2\r\n1\r").await.unwrap();
        assert_eq!(read_until(&mut first, "0000\r\n").await, "OK: SVON\r\n0000\r\n");
        second.write_all(b"HOSTCTRL_REQUEST RSTATS 0\r\n").await.unwrap();
        assert_eq!(read_until(&mut second, ",64\r").await, "OK: RSTATS\r\n196,64\r");
        first.write_all(b"HOSTCTRL_REQUEST RSTATS 0\r\n").await.unwrap();
        assert_eq!(read_until(&mut first, ",64\r").await, "OK: RSTATS\r\n196,64\r");
        let mut rest = Vec::new();
        first.read_to_end(&mut rest).await.unwrap();
        assert_eq!(rest, b"", "two commands were all");
        second.write_all(b"DANCE\r\n").await.unwrap();
        assert_eq!(read_until(&mut second, "\r\n").await, "NG: request refused\r\n");
    });
}

#[test]
fn a_host_on_the_pseudo_terminal_gets_its_answer_and_may_come_again() {
    let links = LinkOptions {
        serial_baud: None,
        ..LinkOptions::default()
    };
    with_host_links(links, |_, path| async move {
        for _ in 0..2 {
            let mut line = tokio_serial::new(&path, 9600)
                .parity(tokio_serial::Parity::Even)
                .open_native_async()
                .unwrap();
            let mut host = Link::new(Timing::default(), Contention::Yield);
            host.send(0, BscMessage::new("01,000", b"RJDIR *\r"));
            let mut answer = None;
            while answer.is_none() {
                match host.poll_output() {
                    Some(LinkOutput::Bytes(bytes)) => AsyncWriteExt::write_all(&mut line, &bytes).await.unwrap(),
                    Some(LinkOutput::Message(message)) => answer = Some(message),
                    Some(told) => assert_eq!(told, LinkOutput::Sent),
                    None => {
                        let mut piece = [0; 64];
                        let byte_count = line.read(&mut piece).await.unwrap();
                        host.handle_bytes(0, &piece[..byte_count]);
                    }
                }
            }
            assert_eq!(answer, Some(BscMessage::new("90,001", b"BLADESCAN,SIMULATED\r")));
        }
    });
}

#[test]
fn a_port_in_use_is_named_in_the_error() {
    let taken = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let error = within_deadline(Sockets::open(&Wanted {
        hses: Some(port),
        ..Wanted::default()
    }))
    .unwrap_err()
    .to_string();
    assert!(
        error.starts_with(&format!("cannot listen on 127.0.0.1:{port} (UDP)")),
        "{error}"
    );
}
