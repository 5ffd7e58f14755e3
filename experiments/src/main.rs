//! Measurements of bladescan that are too slow or too specific for its tests.

mod bench;
mod bound;
mod bsc;
mod camera;
mod camera_faults;
mod camera_line;
mod cases;
mod chaos;
mod cleaning;
mod disk;
mod doubt;
mod frames;
mod fuzz;
mod generate;
mod golden;
mod hold;
mod kabsch;
mod large;
mod methods;
mod model;
mod mpe;
mod pairs;
mod paper;
mod processes;
mod speed;
mod wire;

use clap::{Parser, Subcommand};

/// Measurements of bladescan.
#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Registers every case folder under a root and compares with the truth.
    Pairs(pairs::PairsArguments),
    /// Prints the Cramer-Rao bound of every case folder under a root.
    Bound(bound::BoundArguments),
    /// Registers every case folder under a root by bladescan and by the methods the paper compares itself with.
    Methods(methods::MethodsArguments),
    /// Computes the paper's tables and figures anew.
    Paper(paper::PaperArguments),
    /// Writes one page out of what `paper` has left in a folder.
    PaperPage(paper::page::PageArguments),
    /// Compares ours with today's open programs, out of what `experiments/peers/` has measured.
    Peers(paper::peers::PeersArguments),
    /// Registers the views of a folder one after the other to the growing model.
    Model(model::ModelArguments),
    /// Writes case folders with known truth, of the kinds that registration is judged by.
    Generate(generate::GenerateArguments),
    /// Writes the benchmark of blade registration in plain files, with a data card and checksums.
    CaseSet(generate::case_set::CaseSetArguments),
    /// Compares errors among noise with the covariance that is stated.
    Doubt(doubt::DoubtArguments),
    /// Compares MPE's formulations, stride rules and softening schedules on samples of the blades under a root.
    Mpe(mpe::MpeArguments),
    /// Checks client and simulated controller against golden HSES frames, or the simulated serial link against a recorded exchange.
    Golden(golden::GoldenArguments),
    /// Feeds random and mutated inputs to every decoder.
    Fuzz(fuzz::FuzzArguments),
    /// Sends frames of other HSES clients to the simulated controller.
    Frames(frames::FramesArguments),
    /// Prints one table of the registration's speed: kernels, full-sample MPE, one view by stage.
    Bench(bench::BenchArguments),
    /// Compares what cleaning takes out with the simulator's truth.
    Cleaning(cleaning::CleaningArguments),
    /// Registers two clouds of ten million points: time by stage and memory.
    Large(large::LargeArguments),
    /// Drives the arm over a bad wire and in a bad cell, many times.
    Wire(wire::WireArguments),
    /// Measures the simulated camera: noise on planes, missing pixels on blades, time of a frame.
    Camera(camera::CameraArguments),
    /// Makes whole runs against a camera that goes wrong, many times.
    CameraFaults(camera_faults::CameraFaultsArguments),
    /// Kills real runs at random instants, resumes them, and looks for what is lost or moved twice.
    Processes(processes::ProcessesArguments),
    /// Makes whole runs in which anything may go wrong, and takes them up again.
    Chaos(chaos::ChaosArguments),
    /// Makes a day's runs, one after the other, and watches memory and files.
    Soak(chaos::soak::SoakArguments),
    /// Makes whole runs on a disk that is full, read-only or slow from each record on.
    Disk(disk::DiskArguments),
    /// Measures how soon a hold reaches the robot over each link while a registration keeps all cores busy.
    Hold(hold::HoldArguments),
    /// Times the parts that have a budget, on generated data.
    Speed,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    match Arguments::parse().command {
        Command::Pairs(arguments) => pairs::run(&arguments),
        Command::Bound(arguments) => bound::run(&arguments),
        Command::Methods(arguments) => methods::run(&arguments),
        Command::Paper(arguments) => paper::run(&arguments),
        Command::PaperPage(arguments) => paper::page::run(&arguments),
        Command::Peers(arguments) => paper::peers::run(&arguments),
        Command::Model(arguments) => model::run(&arguments),
        Command::Generate(arguments) => generate::run(&arguments),
        Command::CaseSet(arguments) => generate::case_set::run(&arguments),
        Command::Doubt(arguments) => doubt::run(&arguments),
        Command::Mpe(arguments) => mpe::run(&arguments),
        Command::Golden(arguments) => golden::run(&arguments),
        Command::Fuzz(arguments) => fuzz::run(&arguments),
        Command::Frames(arguments) => frames::run(&arguments),
        Command::Bench(arguments) => bench::run(&arguments),
        Command::Cleaning(arguments) => cleaning::run(&arguments),
        Command::Large(arguments) => large::run(&arguments),
        Command::Wire(arguments) => wire::run(&arguments),
        Command::Camera(arguments) => camera::run(&arguments),
        Command::CameraFaults(arguments) => camera_faults::run(&arguments),
        Command::Processes(arguments) => processes::run(&arguments),
        Command::Chaos(arguments) => chaos::run(&arguments),
        Command::Soak(arguments) => chaos::soak::run(&arguments),
        Command::Disk(arguments) => disk::run(&arguments),
        Command::Hold(arguments) => hold::run(&arguments),
        Command::Speed => speed::run(),
    }
}
