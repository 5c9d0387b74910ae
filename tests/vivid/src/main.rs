//! Tests of live capture on the kernel's virtual camera driver `vivid`, and a player that feeds it.
//!
//! Runs inside the virtual machine of `script/vivid`; on any machine with the driver, as root, it can be used
//! by hand: it changes the driver's settings.

mod checks;
mod driver;
mod layout;
mod player;
mod program;
mod service;
mod stream;
mod trial;

use anyhow::{Result, ensure};
use clap::Parser;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

#[derive(Parser)]
enum Command {
    /// Run the checks; all of them, or those whose names contain one of the words
    Check {
        /// Parts of names
        words: Vec<String>,
    },
    /// Try `loopbox agent` for so many minutes: kills, unplugging, stops, a full disk
    Agent {
        /// How long
        minutes: f64,
        /// Pictures a second
        #[arg(default_value_t = 3.0)]
        rate: f64,
    },
    /// Try the service of the Debian package, under systemd
    Service {
        /// Pictures a second
        #[arg(default_value_t = 5.0)]
        rate: f64,
    },
    /// Play a folder of pictures into the driver's output until it is interrupted
    Play {
        /// The folder
        folder: PathBuf,
        /// Pictures per second
        #[arg(long, default_value_t = 15.0)]
        pace: f64,
        /// GREY, Y16, YUYV, UYVY or NV12
        #[arg(long, default_value = "GREY")]
        format: String,
    },
}

fn main() -> ExitCode {
    match Command::parse() {
        Command::Check { words } => check(&words),
        Command::Agent { minutes, rate } => report(trial::run(minutes, rate), "The agent was always back"),
        Command::Service { rate } => report(service::run(rate), "The service does what its unit promises"),
        Command::Play { folder, pace, format } => match play(&folder, pace, &format) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprintln!("error: {error:#}");
                ExitCode::FAILURE
            }
        },
    }
}

/// Tells what became of a trial, in the form of `cargo test`.
fn report(found: Result<()>, well: &str) -> ExitCode {
    match found {
        Ok(()) => {
            println!("\ntest result: ok. {well}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            println!("{error:?}\n\ntest result: FAILED.");
            ExitCode::FAILURE
        }
    }
}

fn play(folder: &std::path::Path, pace: f64, format: &str) -> Result<()> {
    ensure!(pace.is_finite() && pace > 0.0, "--pace {pace} is not a rate");
    let pictures = player::pictures(folder)?;
    ensure!(!pictures.is_empty(), "{}: no pictures", folder.display());
    let known = layout::FORMATS.into_iter().find(|known| *known == format);
    let (width, height) = pictures[0].dimensions();
    let Some(format) = known else {
        anyhow::bail!("--format {format}: there are {}", layout::FORMATS.join(", "));
    };
    let mode = driver::Mode { width, height, format, ..driver::Mode::USUAL };
    let player = player::Player::start(&pictures, &mode, player::Pace::PerSecond(pace))?;
    loop {
        player.wait_for(pictures.len())?;
        std::thread::park();
    }
}

/// Runs the checks one after the other, with a line for each and one for all in the form of `cargo test`.
fn check(words: &[String]) -> ExitCode {
    let chosen = |name: &str| words.is_empty() || words.iter().any(|word| name.contains(word.as_str()));
    let (mut passed, mut failed, mut left_out) = (0, 0, 0);
    for (name, check) in checks::ALL {
        if !chosen(name) {
            left_out += 1;
            continue;
        }
        let start = Instant::now();
        let verdict = check();
        let seconds = start.elapsed().as_secs_f64();
        match verdict {
            Ok(note) => {
                passed += 1;
                println!("test {name} ... ok ({seconds:.1} s) {note}");
            }
            Err(error) => {
                failed += 1;
                println!("test {name} ... FAILED ({seconds:.1} s)\n{error:?}");
            }
        }
    }
    let word = if failed == 0 { "ok" } else { "FAILED" };
    println!(
        "\ntest result: {word}. {passed} passed; {failed} failed; 0 ignored; 0 measured; {left_out} filtered out"
    );
    if failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
