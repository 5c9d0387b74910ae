//! Maps.

use crate::arrays::{image_view, matrix, table, view};
use crate::failed;
use loopbox::open::open_map;
use map::{CloudSelection, KeyframeId};
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyIndexError, PyKeyError, PyUserWarning};
use pyo3::prelude::*;
use pyo3::types::{PyIterator, PyList};
use std::ffi::CString;
use std::path::PathBuf;
use std::sync::Arc;

/// A map of one agent or several; it does not change.
#[pyclass(frozen, module = "loopbox")]
pub struct Map(pub Arc<map::Map>);

/// A keyframe of a map.
#[pyclass(frozen, module = "loopbox")]
pub struct Keyframe {
    map: Arc<map::Map>,
    id: KeyframeId,
}

/// Points of a map, a row each.
#[pyclass(frozen, get_all, module = "loopbox")]
pub struct Cloud {
    positions: Py<PyArray2<f32>>,
    intensities: Py<PyArray1<u8>>,
    colors: Py<PyArray2<u8>>,
    confidences: Py<PyArray1<f32>>,
    agents: Py<PyArray1<u16>>,
}

/// Says warnings as Python does.
pub fn warn(py: Python<'_>, texts: impl IntoIterator<Item = String>) -> PyResult<()> {
    let category = py.get_type::<PyUserWarning>();
    texts.into_iter().try_for_each(|text| {
        let text = CString::new(text.replace('\0', " ")).unwrap_or_default();
        PyErr::warn(py, &category, &text, 2)
    })
}

#[pymethods]
impl Map {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let opened = py.detach(|| open_map(&path)).map_err(failed)?;
        warn(py, opened.warnings)?;
        Ok(Self(Arc::new(opened.map)))
    }

    #[getter]
    fn agents(&self) -> Vec<String> {
        self.0.agents.values().map(|agent| agent.name.clone()).collect()
    }

    /// Whether a unit is a metre.
    #[getter]
    fn metric(&self) -> bool {
        self.0.is_metric()
    }

    fn __len__(&self) -> usize {
        self.0.keyframes.len()
    }

    fn __repr__(&self) -> String {
        format!(
            "<loopbox.Map of {}: {} keyframes, {} frames>",
            self.agents().join(", "),
            self.__len__(),
            self.0.frames.len()
        )
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyIterator>> {
        PyList::new(py, self.keyframes())?.try_iter()
    }

    /// The keyframe at this place in their order; of a negative one from the end.
    fn __getitem__(&self, index: isize) -> PyResult<Keyframe> {
        let count = self.0.keyframes.len();
        let place = if index < 0 { count.checked_add_signed(index) } else { usize::try_from(index).ok() };
        let found = place.and_then(|place| self.0.keyframes.keys().nth(place));
        let found = found
            .ok_or_else(|| PyIndexError::new_err(format!("{index}, and there are {count} keyframes")))?;
        Ok(Keyframe { map: self.0.clone(), id: *found })
    }

    /// The keyframe with this `id`.
    fn keyframe(&self, id: u32) -> PyResult<Keyframe> {
        let id = KeyframeId(id);
        match self.0.keyframes.contains_key(&id) {
            true => Ok(Keyframe { map: self.0.clone(), id }),
            false => Err(PyKeyError::new_err(id.0)),
        }
    }

    #[getter]
    fn keyframes(&self) -> Vec<Keyframe> {
        self.0.keyframes.keys().map(|&id| Keyframe { map: self.0.clone(), id }).collect()
    }

    /// world_from_camera of the keyframes in their order, n×4×4.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let keyframes = self.0.keyframes.values();
        let values: Vec<f64> =
            keyframes.flat_map(|keyframe| matrix(&keyframe.world_from_keyframe.rigid())).collect();
        PyArray1::from_vec(py, values).reshape([self.0.keyframes.len(), 4, 4])
    }

    /// A row for each frame: timestamp tx ty tz qx qy qz qw.
    #[pyo3(signature = (agent=None))]
    fn trajectory<'py>(&self, py: Python<'py>, agent: Option<&str>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let poses = match agent {
            None => self.0.trajectory(),
            Some(name) => {
                let found = self.0.agents.iter().find(|(_, about)| about.name == name);
                let (id, _) = found.ok_or_else(|| PyKeyError::new_err(name.to_owned()))?;
                self.0.trajectory_of(*id)
            }
        };
        let row =
            |pose: &map::StampedPose| [pose.timestamp].into_iter().chain(pose.world_from_camera.to_tum());
        table(py, poses.iter().flat_map(row).collect(), 8)
    }

    /// Points whose variance of inverse depth over its square is at most this; of each cube of edge `voxel` the surest.
    #[pyo3(signature = (max_variance=map::DEFAULT_MAX_RELATIVE_VARIANCE, voxel=None))]
    fn cloud(&self, py: Python<'_>, max_variance: f32, voxel: Option<f64>) -> PyResult<Cloud> {
        let (mut positions, mut intensities, mut confidences, mut agents) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut colors = Vec::new();
        py.detach(|| {
            let mut add = |point: map::CloudPoint| {
                positions.extend(point.position.iter().map(|&value| value as f32));
                intensities.push(point.intensity);
                colors.extend(point.color.unwrap_or([point.intensity; 3]));
                confidences.push(point.confidence);
                agents.push(point.agent.0);
            };
            match voxel {
                Some(edge) => self.0.thinned_cloud(max_variance, edge).for_each(&mut add),
                None => self.0.cloud(max_variance).for_each(&mut add),
            }
        });
        Ok(Cloud {
            positions: table(py, positions, 3)?.unbind(),
            intensities: PyArray1::from_vec(py, intensities).unbind(),
            colors: table(py, colors, 3)?.unbind(),
            confidences: PyArray1::from_vec(py, confidences).unbind(),
            agents: PyArray1::from_vec(py, agents).unbind(),
        })
    }

    /// Writes the map as a map.mcap.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| map::save_map(path, &self.0)).map_err(failed)
    }

    /// Writes the cloud; gives the number of points.
    #[pyo3(signature = (path, max_variance=map::DEFAULT_MAX_RELATIVE_VARIANCE, voxel=None))]
    fn save_ply(
        &self,
        py: Python<'_>,
        path: PathBuf,
        max_variance: f32,
        voxel: Option<f64>,
    ) -> PyResult<usize> {
        let selection = CloudSelection { voxel, ..max_variance.into() };
        py.detach(|| map::save_ply(&path, &self.0, selection)).map_err(failed)
    }
}

impl Keyframe {
    fn inner(&self) -> &map::Keyframe {
        &self.map.keyframes[&self.id]
    }
}

#[pymethods]
impl Keyframe {
    #[getter]
    fn id(&self) -> u32 {
        self.id.0
    }

    #[getter]
    fn agent(&self) -> &str {
        self.map.agents.get(&self.inner().agent).map_or("", |agent| &agent.name)
    }

    #[getter]
    fn timestamp(&self) -> f64 {
        self.inner().timestamp
    }

    #[getter]
    fn frame_index(&self) -> u64 {
        self.inner().frame_index
    }

    fn __repr__(&self) -> String {
        format!("<loopbox.Keyframe {} of {} at {} s>", self.id(), self.agent(), self.timestamp())
    }

    /// world_from_camera, 4×4.
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        table(py, matrix(&self.inner().world_from_keyframe.rigid()), 4)
    }

    /// Map units of one of its own units of depth.
    #[getter]
    fn unit(&self) -> f64 {
        self.inner().world_from_keyframe.scale
    }

    /// The 3×3 matrix of its undistorted image's camera; pixel centres at integers.
    #[getter]
    fn camera<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let camera = self.map.camera_of(self.inner());
        let rows = |c: &geometry::Pinhole| vec![c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0];
        camera.map(|camera| table(py, rows(camera), 3)).transpose()
    }

    /// The undistorted grey image, rows × columns.
    #[getter]
    fn image<'py>(this: Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<u8>>> {
        // SAFETY: the keyframe holds the map, which nothing changes.
        unsafe { image_view(&this.get().inner().image, this.clone().into_any()) }
    }

    /// The undistorted image in colour, rows × columns × 3 (red, green, blue); None where its source was grey.
    #[getter]
    fn color<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray3<u8>>>> {
        let keyframe = self.inner();
        let (width, height) = (keyframe.image.width(), keyframe.image.height());
        let Some(colors) = keyframe.colors() else { return Ok(None) };
        let pixels = py.detach(|| colors.painted(&keyframe.image, &colors.planes(width, height)));
        PyArray1::from_vec(py, pixels).reshape([height, width, 3]).map(Some)
    }

    /// Indices row · columns + column of the pixels with depth, ascending.
    #[getter]
    fn pixels(this: Bound<'_, Self>) -> Bound<'_, PyArray1<u32>> {
        // SAFETY: the keyframe holds the map, which nothing changes.
        unsafe { view(&this.get().inner().semi_dense.pixel, this.clone().into_any()) }
    }

    /// Of those pixels 1/z, in one over its own unit.
    #[getter]
    fn inverse_depths(this: Bound<'_, Self>) -> Bound<'_, PyArray1<f32>> {
        // SAFETY: the keyframe holds the map, which nothing changes.
        unsafe { view(&this.get().inner().semi_dense.inverse_depth, this.clone().into_any()) }
    }

    /// Of the inverse depths.
    #[getter]
    fn variances(this: Bound<'_, Self>) -> Bound<'_, PyArray1<f32>> {
        // SAFETY: the keyframe holds the map, which nothing changes.
        unsafe { view(&this.get().inner().semi_dense.variance, this.clone().into_any()) }
    }

    /// Depth along the optical axis in map units, rows × columns; NaN where none is known.
    fn depth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (keyframe, unit) = (self.inner(), self.unit() as f32);
        let (width, height) = (keyframe.image.width(), keyframe.image.height());
        let mut depth = vec![f32::NAN; width * height];
        for (pixel, inverse_depth, _) in keyframe.semi_dense.iter() {
            if let Some(place) = depth.get_mut(pixel as usize) {
                *place = unit / inverse_depth;
            }
        }
        PyArray1::from_vec(py, depth).reshape([height, width])
    }
}
