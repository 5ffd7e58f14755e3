use tokio::sync::oneshot;

use super::*;
use crate::blade::Builtin;
use crate::camera::message::Message;
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
        let renderer = Arc::new(Renderer::new(&Builtin::HptA.mesh(), scene.noise).unwrap());
        let sockets = Sockets::open(Some(0), Some(0)).await.unwrap();
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

#[test]
fn a_port_in_use_is_named_in_the_error() {
    let taken = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let error = within_deadline(Sockets::open(Some(port), None))
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with(&format!("cannot listen on 127.0.0.1:{port} (UDP)")),
        "{error}"
    );
}
