//! Frames one by one.

use crate::arrays::{matrix, picture, table};
use crate::failed;
use crate::maps::Map;
use anyhow::{Context, Result, ensure};
use geometry::{Camera, GrayImage, Se3};
use map::AgentId;
use numpy::{PyArray2, PyReadonlyArrayDyn};
use place_recog::ThumbnailIndex;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use slam_direct::{FrameReport, LazyColor, Params, ScaleBreak, TrackingState};
use sources::correction::{CameraOptions, ImageCorrection, correction};
use sources::{FoundCalibration, SourceInfo};
use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// Tracks a camera and maps what it sees.
#[pyclass(frozen, module = "loopbox")]
pub struct Agent {
    correction: Arc<ImageCorrection>,
    name: String,
    working: Mutex<Working>,
}

/// What changes from frame to frame.
struct Working {
    agent: slam_direct::Agent,
    frames: u64,
    /// Time stamp of the newest frame, seconds.
    newest: f64,
}

/// What became of a frame.
#[pyclass(frozen, module = "loopbox")]
pub struct Frame {
    state: TrackingState,
    world_from_camera: Option<Se3>,
    covariance: Option<Vec<f64>>,
    #[pyo3(get)]
    keyframe: Option<u32>,
    #[pyo3(get)]
    matched_points: usize,
    #[pyo3(get)]
    reason: Option<&'static str>,
    scale_break: Option<ScaleBreak>,
}

#[pymethods]
impl Agent {
    #[new]
    #[pyo3(signature = (calibration, *, name="agent", params=None))]
    fn new(calibration: &Bound<'_, PyAny>, name: &str, params: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let params = read_params(params)?;
        let calibration = if let Ok(fields) = calibration.cast::<PyDict>() {
            let camera = calib::parse_camera(&yaml(fields)?, "the calibration").map_err(failed)?.camera;
            Calibration::Given(Box::new(camera))
        } else if let Ok(path) = calibration.extract::<PathBuf>() {
            Calibration::File(path)
        } else {
            let text = "the calibration is the path of a camera.yaml, or a dict with its fields";
            return Err(PyTypeError::new_err(text));
        };
        let correction = calibration.correction().map_err(failed)?;
        let places = Box::new(ThumbnailIndex::default());
        let agent = slam_direct::Agent::new(correction.camera(), places, params).map_err(failed)?;
        let correction = Arc::new(correction);
        Ok(Self { correction, name: name.to_owned(), working: Mutex::new(Working::new(agent)) })
    }

    /// Tracks the next frame: rows × columns (grey) or × 3 (red, green, blue); time stamps grow, seconds.
    fn process(&self, py: Python<'_>, image: PyReadonlyArrayDyn<'_, u8>, timestamp: f64) -> PyResult<Frame> {
        let picture = picture(&image)?;
        let report = py.detach(|| {
            let picture = picture.into_grey_and_color().map_err(anyhow::Error::msg)?;
            let frame = self.correction.frame(picture).map_err(anyhow::Error::msg)?;
            self.working.lock().unwrap_or_else(PoisonError::into_inner).process(frame, timestamp)
        });
        let report = report.map_err(|error: anyhow::Error| failed(error))?;
        Ok(Frame {
            state: report.state,
            world_from_camera: report.world_from_camera,
            covariance: report.covariance.map(|covariance| covariance.as_slice().to_vec()),
            keyframe: report.new_keyframe.map(|id| id.0),
            matched_points: report.matched_points,
            reason: report.reason,
            scale_break: report.scale_break,
        })
    }

    /// The map after the last frame: depth and loops of the last keyframes, and the last optimisation of all.
    fn finish(&self, py: Python<'_>) -> Map {
        py.detach(|| {
            self.working.lock().unwrap_or_else(PoisonError::into_inner).agent.finish();
        });
        self.map(py)
    }

    /// The map as it stands; the agent can go on.
    fn map(&self, py: Python<'_>) -> Map {
        let map = py.detach(|| {
            let mut map = self.working.lock().unwrap_or_else(PoisonError::into_inner).agent.snapshot();
            if let Some(about) = map.agents.get_mut(&AgentId::default()) {
                about.name.clone_from(&self.name);
            }
            map
        });
        Map(Arc::new(map))
    }
}

impl Working {
    fn new(agent: slam_direct::Agent) -> Self {
        Self { agent, frames: 0, newest: f64::NEG_INFINITY }
    }

    fn process(
        &mut self,
        (image, color): (GrayImage, Option<LazyColor>),
        timestamp: f64,
    ) -> Result<FrameReport> {
        let Self { frames: index, newest, .. } = *self;
        // Neither is what is no number.
        ensure!(
            timestamp > newest,
            "frame {index}: its time of {timestamp} s does not follow the {newest} s of the one before"
        );
        let report = self.agent.process(slam_direct::Frame { index, timestamp, image, color })?;
        (self.frames, self.newest) = (index + 1, timestamp);
        Ok(report)
    }
}

#[pymethods]
impl Frame {
    /// "starting", "tracking" or "lost".
    #[getter]
    fn state(&self) -> &'static str {
        loopbox::run::state_name(self.state)
    }

    /// world_from_camera as known now, 4×4.
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.world_from_camera.map(|pose| table(py, matrix(&pose), 4)).transpose()
    }

    /// Covariance of the pose relative to the keyframes around it, 6×6: of (υ, ω), in the axes of the camera, map units and radians. What
    /// the map errs from one place to another is not in it; None for frames that begin a map.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.covariance.clone().map(|covariance| table(py, covariance, 6)).transpose()
    }

    /// Where the scale was not carried on, some keyframes ago: the keyframe `before`, how many `points` measure the scale across it, and
    /// the `inliers` among them. What is mapped since then has a unit of its own; each place is said once.
    #[getter]
    fn scale_break<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let fields = |found: ScaleBreak| {
            let fields = PyDict::new(py);
            fields.set_item("before", found.before.0)?;
            fields.set_item("points", found.points)?;
            fields.set_item("inliers", found.inliers)?;
            Ok(fields)
        };
        self.scale_break.map(fields).transpose()
    }

    fn __repr__(&self) -> String {
        format!("<loopbox.Frame: {}, {} points matched>", self.state(), self.matched_points)
    }
}

/// The camera that took the images.
enum Calibration {
    File(PathBuf),
    Given(Box<Camera>),
}

impl Calibration {
    fn correction(self) -> Result<ImageCorrection> {
        let (file, found) = match self {
            Self::File(path) => (Some(path), None),
            Self::Given(camera) => {
                (None, Some(FoundCalibration::Inside { origin: "the calibration".into(), camera }))
            }
        };
        let options = CameraOptions { calibration: file, ..CameraOptions::default() };
        let info = SourceInfo { calibration: found, ..SourceInfo::new("frames from Python", "frames") };
        correction(&options, &info)
    }
}

/// The fields of a `camera.yaml` as text.
fn yaml(fields: &Bound<'_, PyDict>) -> PyResult<String> {
    let mut text = String::new();
    for (key, value) in fields {
        let _ = writeln!(text, "{}: {}", key.str()?, value.str()?);
    }
    Ok(text)
}

/// Parameters as `loopbox params` names them, in their sections; what is not named keeps its default.
pub fn read_params(params: Option<&Bound<'_, PyDict>>) -> PyResult<Params> {
    let Some(params) = params else { return Ok(Params::default()) };
    let text: String = params.py().import("json")?.call_method1("dumps", (params,))?.extract()?;
    serde_json::from_str(&text).context("params").map_err(failed)
}
