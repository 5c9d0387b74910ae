//! `loopbox calib`: calibrates a camera.

use super::calib_check::Checked;
use super::calib_photometric::{self, PhotometricArgs};
#[cfg(feature = "view")]
use super::watching::ServeArgs;
use crate::console::{self, tell, usage};
use crate::interrupt::stop_on_ctrl_c;
use anyhow::{Context, Result, anyhow, bail};
use calib::coach::Coverage;
use calib::{Board, Calibration, LensModel, SolverParams, calibrate, read_camera};
use clap::Args;
use loopbox::calibrating::{
    Coaching, CollectProgress, Collected, Input, Numbers, Output, Shots, camera_text, collect, render_report,
    table,
};
use sources::SourceOptions;
use sources::Stop;
use sources::camera::CameraArgs;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

/// Calibrate a camera: from images of a board its focal lengths, principal point and distortion; from an exposure sweep
/// its response; from a flat surface its vignette
#[derive(Debug, Args)]
pub struct CalibArgs {
    /// Images of the board: files, a folder of them, or one recording
    #[arg(value_name = "IMAGE|FOLDER|RECORDING", conflicts_with = "camera")]
    images: Vec<PathBuf>,
    /// The board: chessboard:9x6:0.025 (inner corners, side of a square in metres), charuco:7x5:0.04:0.03[:DICT_4X4_50]
    /// (squares, sides of square and marker), aprilgrid:6x6:0.088:0.3 (tags 36h11, side of a tag, gap as share of it)
    #[arg(long, value_name = "BOARD")]
    board: Option<Board>,
    #[command(flatten)]
    camera: CameraArgs,
    /// Camera model: pinhole, radtan (k1 k2 p1 p2), radtan5 (k3 too), kb4 (fisheye), fov
    #[arg(long, value_name = "MODEL", default_value = "radtan")]
    model: LensModel,
    /// Of a chessboard: pixels around each corner that its exact place is found from; default: a third of the distance
    /// between corners. More sees the neighbours, and puts corners wrong
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u16).range(1..=100))]
    window: Option<u16>,
    /// The calibration to write: camera.yaml, or with --response pcalib.txt, with --vignette vignette.png
    #[arg(short, long, value_name = "FILE", required_unless_present = "check")]
    out: Option<PathBuf>,
    /// Instead of calibrating, tell how well this calibration fits the images: others than it was made from, to be fair.
    /// Any form of calibration that `run` reads
    #[arg(long, value_name = "FILE", conflicts_with_all = ["out", "report", "model", "response", "vignette"])]
    check: Option<PathBuf>,
    /// Also write a page that shows coverage, residuals and detections
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Print all numbers as JSON instead of the summary
    #[arg(long)]
    json: bool,
    /// Show no progress
    #[arg(short, long)]
    quiet: bool,
    #[cfg(feature = "view")]
    #[command(flatten)]
    serve: ServeArgs,
    #[command(flatten)]
    photometric: PhotometricArgs,
}

impl CalibArgs {
    /// Where to serve the page, if that is asked for.
    #[cfg(feature = "view")]
    fn address(&self) -> Result<Option<view::watch::web::Address>> {
        self.serve.address()
    }

    /// Nowhere.
    #[cfg(not(feature = "view"))]
    fn address(&self) -> Result<Option<std::convert::Infallible>> {
        Ok(None)
    }
}

/// Runs `loopbox calib`.
///
/// # Errors
/// When images cannot be read or do not determine the camera, or a file cannot be written. Then nothing is written.
pub fn run(args: &CalibArgs) -> Result<()> {
    if args.address()?.is_some() && (args.photometric.asked_for() || args.check.is_some()) {
        return usage(Err(anyhow!(
            "--view shows what is missing of a board\nhint: leave it out with --response, --vignette and --check"
        )));
    }
    if let Some(out) = args.out.as_deref().filter(|_| args.photometric.asked_for()) {
        return calib_photometric::run(&args.photometric, &args.images, out);
    }
    let Some(board) = &args.board else {
        return usage(Err(anyhow!(
            "--board is missing\nhint: --board chessboard:9x6:0.025, charuco:7x5:0.04:0.03 or aprilgrid:6x6:0.088:0.3; with \
             --response or --vignette none is needed"
        )));
    };
    match (&args.check, &args.out) {
        (Some(file), _) => check(args, board, file),
        (None, Some(out)) => calibrate_to(args, board, out),
        (None, None) => {
            bail!("--out is missing\nhint: name the calibration to write, such as --out camera.yaml")
        }
    }
}

/// Tells how well the calibration in `file` fits the images.
fn check(args: &CalibArgs, board: &Board, file: &Path) -> Result<()> {
    let calibration = read_camera(file)?;
    let mut shots = shots(args)?;
    let stop = stop()?;
    let collected = collected(args, board, &mut shots, &Coaching::start(None, board, false)?, &stop)?;
    let checked = Checked::new(file, &calibration, board, &collected)?;
    if args.json { console::print_json(&checked) } else { console::print(&checked.text()) }
}

/// Calibrates, and writes the calibration to `out`.
fn calibrate_to(args: &CalibArgs, board: &Board, out: &Path) -> Result<()> {
    let out = Output::prepare(out)?;
    let mut shots = shots(args)?;
    let page = args.report.as_deref().map(Output::prepare).transpose()?;
    let stop = stop()?;
    let coaching = Coaching::start(args.address()?, board, shots.is_live())?;
    if let Some(url) = coaching.url() {
        tell!("watch at {url}");
    }
    let calibrated =
        measure(args, board, &mut shots, &coaching, &stop).and_then(|(collected, calibration)| {
            write(board, &collected, &calibration, out, page)?;
            Ok((collected, calibration))
        });
    let (collected, calibration) = match calibrated {
        Ok(calibrated) => calibrated,
        Err(error) => {
            coaching.end(Err(&format!("{error:#}")), &stop, |_| {});
            return Err(error);
        }
    };
    let summary = table(&collected, &calibration);
    if args.json {
        console::print_json(&Numbers::new(board, &collected, &calibration))?;
    } else {
        console::print(&summary)?;
    }
    coaching.end(Ok(&summary), &stop, |url| tell!("view at {url}  (Ctrl-C ends)"));
    Ok(())
}

fn stop() -> Result<Stop> {
    stop_on_ctrl_c("calibrating from what was seen so far (Ctrl-C again to abort)")
}

/// Opens what the images come from.
fn shots(args: &CalibArgs) -> Result<Shots> {
    let input = match &args.camera.camera {
        Some(_) => Input::Camera(args.camera.clone()),
        None if args.images.is_empty() => {
            bail!("no images\nhint: give image files, a folder, a recording, or --camera DEVICE")
        }
        None => Input::Paths(args.images.clone()),
    };
    let options = SourceOptions { fps: args.camera.fps.or(Some(30.0)), topic: None, all_frames: true };
    let mut shots = Shots::open(&input, &options)?;
    shots.listen(Box::new(|notice| tell!("{}", notice.text())));
    Ok(shots)
}

/// Finds the board in the images.
fn collected(
    args: &CalibArgs,
    board: &Board,
    shots: &mut Shots,
    coaching: &Coaching,
    stop: &Stop,
) -> Result<Collected> {
    let mut coach = Coach { quiet: args.quiet, stream: shots.is_stream(), last: Vec::new() };
    let mut go_on = |seen: &CollectProgress| {
        coach.report(seen.given, seen.coverage);
        coaching.show(seen);
        !stop.requested() && !coaching.has_enough()
    };
    stop.while_waiting(shots.stopper(), || collect(shots, board, args.window, &mut go_on))
}

/// Looks at the images and calibrates from them.
fn measure(
    args: &CalibArgs,
    board: &Board,
    shots: &mut Shots,
    coaching: &Coaching,
    stop: &Stop,
) -> Result<(Collected, Calibration)> {
    let collected = collected(args, board, shots, coaching, stop)?;
    coaching.solving();
    let calibration =
        calibrate(board, &collected.views(), collected.size, args.model, &SolverParams::default())
            .with_context(|| not_used(&collected))?;
    Ok((collected, calibration))
}

/// Writes the calibration, and the page of the report if one is wanted: both or none.
fn write(
    board: &Board,
    collected: &Collected,
    calibration: &Calibration,
    out: Output,
    page: Option<Output>,
) -> Result<()> {
    out.write(camera_text(board, calibration).as_bytes())?;
    if let Some(page) = page {
        page.write(render_report(board, collected, calibration)?.as_bytes())?;
        page.commit()?;
    }
    out.commit()
}

/// What was left out, to stand before the reason why the rest is not enough.
fn not_used(collected: &Collected) -> String {
    let problems = collected.shots.iter().filter_map(|shot| Some((&shot.name, shot.problem.as_ref()?)));
    let lines: Vec<String> = problems.map(|(name, problem)| format!("{name}: {problem}")).collect();
    let (count, listed) = (lines.len(), lines.iter().take(5).cloned().collect::<Vec<_>>().join("; "));
    match count {
        0 => "not calibrated".into(),
        _ => format!(
            "not calibrated; {count} images were not used ({listed}{})",
            if count > 5 { "; …" } else { "" }
        ),
    }
}

/// Tells on the terminal what was seen and, of a stream, what is missing.
struct Coach {
    quiet: bool,
    stream: bool,
    last: Vec<String>,
}

impl Coach {
    fn report(&mut self, given: usize, coverage: &Coverage) {
        if self.quiet || !std::io::stderr().is_terminal() {
            return;
        }
        tell!(
            "{given} images, {} views, {:.0} % of the image covered",
            coverage.views,
            100.0 * coverage.share()
        );
        let advice = coverage.advice();
        if self.stream && advice != self.last {
            advice.iter().take(3).for_each(|line| tell!("  {line}"));
            self.last = advice;
        }
    }
}
