//! NumPy arrays of what is in Rust's memory.

use geometry::{GrayImage, Se3};
use numpy::ndarray::{ArrayView1, ArrayView2};
use numpy::{Element, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use sources::pictures::{Picture, RawPicture};

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

/// The picture of an array of bytes: rows × columns, or with red, green, blue and perhaps a fourth value a pixel.
pub fn picture(array: &PyReadonlyArrayDyn<'_, u8>) -> PyResult<Picture> {
    let pixels = array.as_array();
    let (height, width, encoding, step) = match *pixels.shape() {
        [height, width] => (height, width, "mono8", width),
        [height, width, 3] => (height, width, "rgb8", 3 * width),
        [height, width, 4] => (height, width, "rgba8", 4 * width),
        ref other => {
            return Err(PyValueError::new_err(format!(
                "an image of shape {other:?}: give rows × columns (grey) or rows × columns × 3 (red, green, blue) of uint8"
            )));
        }
    };
    let data: Vec<u8> = match pixels.as_slice() {
        Some(slice) => slice.to_vec(),
        None => pixels.iter().copied().collect(),
    };
    if data.is_empty() {
        return Err(PyValueError::new_err("the image has no pixels"));
    }
    let encoding = encoding.to_owned();
    Ok(Picture::Raw(RawPicture { width, height, step, encoding, big_endian: false, data }))
}
