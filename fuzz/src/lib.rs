//! What the targets share.

use sources::FoundCalibration;
use std::fs;
use std::path::{Path, PathBuf};

/// Calls a reader that wants a path with a file of these bytes, kept in memory.
///
/// # Panics
/// When there is no memory for the file: that is no finding.
pub fn with_file<T>(name: &str, bytes: &[u8], read: impl FnOnce(&Path) -> T) -> T {
    let path = scratch().join(name);
    fs::write(&path, bytes).expect("a file can be written");
    read(&path)
}

/// A folder of this process, in memory where the system offers that.
///
/// # Panics
/// When it cannot be made.
pub fn scratch() -> PathBuf {
    let memory = Path::new("/dev/shm");
    let base = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    let folder = base.join(format!("loopbox-fuzz-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a folder can be made");
    folder
}

/// Reads all frames of a recording in memory.
pub fn read_recording(bytes: &[u8]) {
    let Ok(mut source) = sources::open_bytes(bytes, &Default::default()) else { return };
    if let Some(FoundCalibration::Inside { camera, .. }) = source.info().calibration.clone() {
        source.expect_camera(&camera);
    }
    while let Some(frame) = source.next_frame() {
        let _ = frame.picture.into_grey();
    }
    let _ = source.warning();
}
