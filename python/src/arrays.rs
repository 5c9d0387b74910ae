//! NumPy arrays of what is in Rust's memory.

use geometry::{GrayImage, Se3};
use numpy::ndarray::{ArrayView1, ArrayView2};
use numpy::{Element, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A read-only view of a slice that `owner` keeps and does not change.
///
/// # Safety
/// The slice must stay where it is as long as `owner` lives.
pub unsafe fn view<'py, T: Element>(slice: &[T], owner: Bound<'py, PyAny>) -> Bound<'py, PyArray1<T>> {
    // SAFETY: as promised by the caller.
    let array = unsafe { PyArray1::borrow_from_array(&ArrayView1::from(slice), owner) };
    array.readwrite().make_nonwriteable();
    array
}

/// A read-only view of an image that `owner` keeps and does not change, rows first.
///
/// # Safety
/// The image must stay where it is as long as `owner` lives.
pub unsafe fn image_view<'py>(
    image: &GrayImage,
    owner: Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<u8>>> {
    let pixels = ArrayView2::from_shape((image.height(), image.width()), image.data());
    let pixels = pixels.map_err(|error| PyValueError::new_err(error.to_string()))?;
    // SAFETY: as promised by the caller.
    let array = unsafe { PyArray2::borrow_from_array(&pixels, owner) };
    array.readwrite().make_nonwriteable();
    Ok(array)
}

/// Rows of numbers, which become the array's memory without a copy.
pub fn table<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    columns: usize,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let rows = values.len() / columns;
    PyArray1::from_vec(py, values).reshape([rows, columns])
}

/// The 4×4 matrix of a pose, row by row.
pub fn matrix(pose: &Se3) -> Vec<f64> {
    pose.to_matrix().transpose().as_slice().to_vec()
}

/// A grey image of an array of bytes: rows × columns, or with three or four colours, of which Rec. 709 luma is taken.
pub fn grey(array: &PyReadonlyArrayDyn<'_, u8>) -> PyResult<GrayImage> {
    let pixels = array.as_array();
    let (height, width, colours) = match *pixels.shape() {
        [height, width] => (height, width, 1),
        [height, width, colours @ (3 | 4)] => (height, width, colours),
        ref other => {
            return Err(PyValueError::new_err(format!(
                "an image of shape {other:?}: give rows × columns (grey) or rows × columns × 3 (red, green, blue) of uint8"
            )));
        }
    };
    let bytes: Vec<u8> = match pixels.as_slice() {
        Some(slice) => slice.to_vec(),
        None => pixels.iter().copied().collect(),
    };
    let luma = |rgb: &[u8]| {
        let [r, g, b] = [rgb[0], rgb[1], rgb[2]].map(u32::from);
        ((2126 * r + 7152 * g + 722 * b) / 10_000) as u8
    };
    let data = if colours == 1 { bytes } else { bytes.chunks_exact(colours).map(luma).collect() };
    GrayImage::from_vec(width, height, data).ok_or_else(|| PyValueError::new_err("the image has no pixels"))
}
