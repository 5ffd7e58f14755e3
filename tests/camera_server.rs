//! The simulated camera on virtual time, as what carries the deeds of `camera::lines`.

use bladescan::camera::lines::{Carry, Deed, News};
use bladescan::settings::Station;
use bladescan::stamp::Stamp;
use hw_sim::blade::Builtin;
use hw_sim::camera::render::Renderer;
use hw_sim::cell::{Cell, Input, Output};
use hw_sim::robot::pose::Pose;
use hw_sim::scene::Scene;
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use std::collections::VecDeque;

/// A cell whose blade stands in the middle of the camera's view, and time that passes only while somebody waits.
struct Server {
    cell: Cell,
    renderer: Renderer,
    now_ns: u64,
    news: VecDeque<News>,
}

/// A simulated camera in which these faults happen.
pub fn simulated_camera(faults: &[String]) -> Carry<'static> {
    let station = Station::builtin_simulated();
    let turned = UnitQuaternion::from_euler_angles(0.0, 90_f64.to_radians(), 0.0);
    let camera_from_blade = Isometry3::from_parts(Translation3::new(0.0, 0.0, 280.0), turned);
    let base_from_tool = station.base_from_camera * camera_from_blade * station.tool_from_blade.inverse();
    let scene = Scene {
        base_from_camera: station.base_from_camera,
        tool_from_blade: station.tool_from_blade,
        home: Pose::from_isometry(&base_from_tool),
        faults: faults.iter().map(|fault| fault.parse().unwrap()).collect(),
        ..Scene::default()
    };
    let mut server = Server {
        renderer: Renderer::new(&Builtin::HptA.mesh(), scene.surface).unwrap(),
        cell: Cell::new(scene),
        now_ns: 0,
        news: VecDeque::new(),
    };
    Box::new(move |deed| server.carry_out(deed))
}

impl Server {
    fn carry_out(&mut self, deed: Deed) -> (Stamp, Option<News>) {
        let news = match deed {
            Deed::Connect { line } => {
                let connection = line as u64;
                self.input(Input::CameraConnected { connection });
                let address = ([127, 0, 0, 1], 40_000 + line as u16).into();
                self.input(Input::CameraAddress { connection, address });
                self.news.push_back(News::Connected { line });
                None
            }
            Deed::Bytes { line, bytes } => {
                let connection = line as u64;
                self.input(Input::CameraBytes { connection, bytes });
                None
            }
            Deed::Close { line } => {
                let connection = line as u64;
                self.input(Input::CameraClosed { connection });
                self.news.retain(|news| !is_of(news, line));
                None
            }
            Deed::Wait { until } => self.wait(until.ns),
        };
        (Stamp { ns: self.now_ns }, news)
    }

    fn wait(&mut self, until_ns: u64) -> Option<News> {
        loop {
            if let Some(news) = self.news.pop_front() {
                return Some(news);
            }
            if self.now_ns >= until_ns {
                return None;
            }
            let due_ns = self.cell.wake_at().unwrap_or(until_ns).max(self.now_ns);
            self.now_ns = due_ns.min(until_ns);
            self.input(Input::Wake);
        }
    }

    fn input(&mut self, input: Input) {
        self.cell.handle_input(self.now_ns, input);
        while let Some(output) = self.cell.poll_output() {
            match output {
                Output::CameraBytes { connection, bytes } => {
                    let line = connection as usize;
                    self.news.push_back(News::Bytes { line, bytes });
                }
                Output::CameraClose { connection } => self.news.push_back(News::Closed {
                    line: connection as usize,
                    reason: "the server closed the connection".into(),
                }),
                Output::Render(job) => {
                    let (job, frame) = (job.job, job.run(&self.renderer));
                    self.input(Input::Rendered { job, frame });
                }
                _ => {}
            }
        }
    }
}

fn is_of(news: &News, wanted: usize) -> bool {
    let (News::Connected { line } | News::Bytes { line, .. } | News::Closed { line, .. }) = news;
    *line == wanted
}
