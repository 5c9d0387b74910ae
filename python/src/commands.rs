//! What the program `loopbox` does over files.

use crate::agent::read_params;
use crate::maps::warn;
use crate::{failed, on_threads};
use anyhow::{Result, bail};
use eval::{AlignMode, Options};
use loopbox::blobs::{local_files, local_pair, local_recording, recordings_at};
use loopbox::lidar::{self, LidarMergeOptions};
use loopbox::merging::MergingParams;
use loopbox::open::{Sensors, sensors_at};
use loopbox::pairs::{ProposedPair, VerdictOptions, find_verdict, is_verdict_kept, propose_pairs};
use loopbox::run::{FrameRow, PreparedRun, Progress, Recording, RunOptions, state_name};
use loopbox::{MergeOptions, merge_maps};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sources::{SourceOptions, Stop};
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Mutex;
use view::watch::Watch;

/// Runs an agent over a recording; its folder of results, and `run.json`.
#[pyfunction]
#[pyo3(signature = (recording, out, *, calibration=None, fov=None, name=None, force=false, fps=None, topic=None, start=None, end=None, params=None, progress=None))]
#[expect(clippy::too_many_arguments, reason = "they are keywords")]
pub fn run(
    py: Python<'_>,
    recording: PathBuf,
    out: PathBuf,
    calibration: Option<PathBuf>,
    fov: Option<f64>,
    name: Option<String>,
    force: bool,
    fps: Option<f64>,
    topic: Option<String>,
    start: Option<f64>,
    end: Option<f64>,
    params: Option<&Bound<'_, PyDict>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(PathBuf, String)> {
    let mut options =
        RunOptions { name, force, start, end, params: read_params(params)?, ..RunOptions::to(out) };
    options.camera.calibration = calibration;
    let reporter =
        Reporter { stop: Stop::default(), progress, error: Mutex::default(), messages: Mutex::default() };
    let result = py.detach(|| {
        on_threads(None, || {
            tracked(&recording, &SourceOptions { fps, topic, all_frames: false }, fov, options, &reporter)
        })
    });
    warn(py, reporter.messages.into_inner().unwrap_or_default())?;
    if let Some(error) = reporter.error.into_inner().unwrap_or_default() {
        return Err(error);
    }
    result.map_err(failed)
}

fn tracked(
    recording: &std::path::Path,
    source: &SourceOptions,
    fov: Option<f64>,
    mut options: RunOptions,
    reporter: &Reporter,
) -> Result<(PathBuf, String)> {
    let path = local_recording(recording, &|_| {})?;
    let recording = Recording { path, options: source.clone() };
    let source = recording.open()?;
    options.without_calibration(source.info(), recording, fov, &reporter.stop, reporter)?;
    let prepared = PreparedRun::new(source, options)?;
    prepared.problems().iter().for_each(|problem| reporter.warn(problem));
    let mapped = prepared.go(|_, _, _| Ok(Watch::none()), &reporter.stop, reporter)?;
    match (mapped.failure, mapped.apart) {
        (Some(failure), _) => bail!("the run ended early, what was tracked is saved: {failure}"),
        (None, Some(apart)) => bail!("{apart}"),
        (None, None) => Ok((mapped.folder, serde_json::to_string(&mapped.record)?)),
    }
}

/// Tells Python how a run goes, and asks it whether to go on.
struct Reporter {
    stop: Stop,
    progress: Option<Py<PyAny>>,
    /// What Python raised meanwhile: Ctrl-C, or an error of the callable.
    error: Mutex<Option<PyErr>>,
    messages: Mutex<Vec<String>>,
}

impl Reporter {
    /// Stops for what Python raised, and keeps it.
    fn heed(&self, asked: PyResult<()>) {
        let Err(error) = asked else { return };
        self.stop.request();
        if let Ok(mut kept) = self.error.lock() {
            *kept = Some(error);
        }
    }
}

impl Progress for Reporter {
    fn frame(&self, row: &FrameRow, _: usize, _: usize) {
        if self.stop.requested() {
            return;
        }
        let asked = Python::attach(|py| {
            py.check_signals()?;
            if let Some(progress) = &self.progress {
                progress.call1(py, (row.index, row.timestamp, state_name(row.state)))?;
            }
            Ok(())
        });
        self.heed(asked);
    }

    fn stage(&self, _: &str) {
        self.heed(Python::attach(|py| py.check_signals()));
    }

    fn warn(&self, text: &str) {
        if let Ok(mut messages) = self.messages.lock() {
            messages.push(text.to_owned());
        }
    }
}

/// Merges maps; whether any two met, the verdict for people, and `merge.json`.
#[pyfunction]
#[pyo3(signature = (maps, out, *, force=false, verdicts=None, confirm=Vec::new()))]
pub fn merge(
    py: Python<'_>,
    maps: Vec<PathBuf>,
    out: PathBuf,
    force: bool,
    verdicts: Option<PathBuf>,
    confirm: Vec<String>,
) -> PyResult<(bool, String, String)> {
    let of_cameras = |maps: &[PathBuf]| -> Result<(bool, String, String)> {
        let (verdicts, confirm) = (verdicts.clone(), confirm.clone());
        let merged = merge_maps(maps, MergeOptions { force, verdicts, confirm, ..MergeOptions::to(&out) })?;
        Ok((merged.any_joined(), merged.verdict(), serde_json::to_string(&merged.record)?))
    };
    let of_lidars = |maps: &[PathBuf]| -> Result<(bool, String, String)> {
        let (verdicts, confirm) = (verdicts.clone(), confirm.clone());
        let options = LidarMergeOptions { force, verdicts, confirm, ..LidarMergeOptions::to(&out) };
        let merged = lidar::merge_maps(maps, &options, &Stop::default(), &mut |_| {})?;
        let record = serde_json::to_string(&merged.record)?;
        Ok((merged.merging.any_joined(), merged.verdict(), record))
    };
    let merged = py.detach(|| {
        on_threads(None, || {
            let maps = local_files(&maps, &|_| {})?;
            match sensors_at(&maps) {
                Sensors::Lidars => of_lidars(&maps),
                Sensors::Cameras | Sensors::Mixed => of_cameras(&maps),
            }
        })
    });
    merged.map_err(failed)
}

/// Judges two maps: whether they are joined, the verdict for people, and its numbers as JSON.
#[pyfunction]
#[pyo3(signature = (a, b, *, verdicts=None, threads=None))]
pub fn verdict(
    py: Python<'_>,
    a: PathBuf,
    b: PathBuf,
    verdicts: Option<PathBuf>,
    threads: Option<usize>,
) -> PyResult<(bool, String, String)> {
    let options = VerdictOptions { verdicts, ..VerdictOptions::default() };
    let evaluated = py.detach(|| {
        on_threads(threads, || {
            let maps = local_pair(&[a, b], &|_| {})?;
            let found = find_verdict(&maps, &options, &Stop::default(), &())?;
            Ok((found.joins, found.text, serde_json::to_string(&found.pair_results)?))
        })
    });
    evaluated.map_err(failed)
}

/// Judges two maps for the verdicts that are kept in `verdicts`, by one thread; what is kept is not looked at again.
#[pyfunction]
pub fn keep_verdict(py: Python<'_>, a: PathBuf, b: PathBuf, verdicts: PathBuf) -> PyResult<()> {
    let options = VerdictOptions { verdicts: Some(verdicts), ..VerdictOptions::default() };
    let kept = py.detach(|| {
        on_threads(Some(1), || {
            let maps = local_pair(&[a, b], &|_| {})?;
            if !is_verdict_kept(&maps, &options)? {
                find_verdict(&maps, &options, &Stop::default(), &())?;
            }
            Ok(())
        })
    });
    kept.map_err(failed)
}

/// The pairs of maps that may show one place, the likeliest first, by their places among `maps`; and how likely each is.
#[pyfunction]
pub fn propose(py: Python<'_>, maps: Vec<PathBuf>) -> PyResult<Vec<(OsString, OsString, Option<f32>)>> {
    let proposed = py.detach(|| {
        on_threads(None, || {
            let pairs = propose_pairs(&maps, &MergingParams::default(), &Stop::default(), &())?;
            let pair = |pair: ProposedPair| {
                // A path of Python's would take one of the two slashes of a URI away.
                let [a, b] = pair.maps.map(PathBuf::into_os_string);
                (a, b, pair.score)
            };
            Ok(pairs.into_iter().map(pair).collect())
        })
    });
    proposed.map_err(failed)
}

/// The recordings that these names stand for: of the URI of a prefix with `/*` behind all that lies there.
#[pyfunction]
pub fn recordings(py: Python<'_>, names: Vec<PathBuf>) -> PyResult<Vec<OsString>> {
    let all = py.detach(|| recordings_at(&names)).map_err(failed)?;
    Ok(all.into_iter().map(PathBuf::into_os_string).collect())
}

/// Compares a trajectory with its ground truth; all measures as JSON.
#[pyfunction]
#[pyo3(signature = (estimate, truth, *, frames=None, align="sim3", max_diff=eval::DEFAULT_MAX_DIFF))]
pub fn evaluate(
    py: Python<'_>,
    estimate: PathBuf,
    truth: PathBuf,
    frames: Option<PathBuf>,
    align: &str,
    max_diff: f64,
) -> PyResult<String> {
    let align = match align {
        "none" => AlignMode::None,
        "se3" => AlignMode::Se3,
        "sim3" => AlignMode::Sim3,
        "scale" => AlignMode::Scale,
        other => {
            let text = format!("align={other:?}: give \"none\", \"se3\", \"sim3\" or \"scale\"");
            return Err(PyValueError::new_err(text));
        }
    };
    let options = Options { align, max_diff, ..Options::default() };
    let measured = py.detach(|| -> Result<String> {
        Ok(serde_json::to_string(&loopbox::evaluate(&estimate, &truth, frames.as_deref(), &options)?)?)
    });
    measured.map_err(failed)
}
