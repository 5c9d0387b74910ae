//! Whether bytes that came from elsewhere are a verdict.

use super::{Kept, OfCameras, VerdictKey};

/// Whether these bytes are the verdict on two maps of cameras that the key names.
pub(crate) fn is_camera_verdict(key: &VerdictKey, bytes: &[u8]) -> bool {
    let Ok(Kept { mut maps, .. }) = rmp_serde::from_slice::<Kept<OfCameras>>(bytes) else { return false };
    maps.sort();
    maps == key.maps
}

/// The verdict on two maps that have nothing in common.
#[cfg(test)]
pub(crate) fn refused_camera_verdict(key: &VerdictKey) -> Vec<u8> {
    let verdict = OfCameras { proposed: 0, tested: Vec::new(), joined: None, error: None };
    rmp_serde::to_vec_named(&Kept { maps: key.maps.clone(), verdict }).expect("numbers and texts")
}
