//! The cameras of this machine.

use super::format::FormatSizes;
use super::node::{Identity, Node};
use std::io;
use std::path::{Path, PathBuf};

/// The hint for a computer without a camera.
pub const NONE_HINT: &str = "no camera is found here: plug one in; in a container or virtual machine, pass its \
                             /dev/video* on; `sudo modprobe uvcvideo` loads the driver of USB cameras";

/// A device that images can be taken from.
#[derive(Debug)]
pub struct FoundCamera {
    /// Its node.
    pub path: PathBuf,
    /// Its name, for people.
    pub name: String,
    /// More of it, or why it cannot be looked at.
    pub details: Result<Details, String>,
}

/// A camera with its formats.
#[derive(Debug)]
pub struct Details {
    /// Its identity.
    pub identity: Identity,
    /// The formats that loopbox can read.
    pub formats: Vec<FormatSizes>,
    /// Codes of its other pixel formats.
    pub others: Vec<String>,
}

/// The nodes `video0`, `video1`, … of a folder, by number.
pub fn nodes(dev: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(dev).into_iter().flatten().flatten();
    let number = |entry: std::fs::DirEntry| -> Option<u32> {
        entry.file_name().to_str()?.strip_prefix("video")?.parse().ok()
    };
    let mut numbers: Vec<u32> = entries.filter_map(number).collect();
    numbers.sort_unstable();
    numbers.into_iter().map(|number| dev.join(format!("video{number}"))).collect()
}

/// The cameras among the nodes of a folder; outputs and nodes of other kinds are left out.
pub fn cameras(dev: &Path) -> Vec<FoundCamera> {
    nodes(dev).into_iter().filter_map(look_at).collect()
}

fn look_at(path: PathBuf) -> Option<FoundCamera> {
    match details(&path) {
        Ok(Some(details)) => {
            let name = details.identity.card.clone();
            Some(FoundCamera { path, name, details: Ok(details) })
        }
        Ok(None) => None,
        Err(error) => match error.raw_os_error() {
            // Files, or devices that went away just now.
            Some(libc::ENOTTY | libc::EINVAL | libc::ENODEV | libc::ENXIO | libc::ENOENT | libc::EISDIR) => {
                None
            }
            Some(libc::EACCES | libc::EPERM) => {
                let reason = "no permission: `sudo usermod -aG video $USER`, then log in again";
                Some(FoundCamera { name: name_in_sys(&path), path, details: Err(reason.into()) })
            }
            _ => Some(FoundCamera { name: name_in_sys(&path), path, details: Err(error.to_string()) }),
        },
    }
}

/// `None` when it is no camera.
fn details(path: &Path) -> io::Result<Option<Details>> {
    let node = Node::open(path)?;
    let (identity, is_camera) = node.identity()?;
    if !is_camera {
        return Ok(None);
    }
    let (formats, others) = node.formats()?;
    Ok(Some(Details { identity, formats, others }))
}

/// The name that the kernel shows to those who may not open the node.
fn name_in_sys(path: &Path) -> String {
    let node = path.file_name().unwrap_or_default();
    let file = Path::new("/sys/class/video4linux").join(node).join("name");
    std::fs::read_to_string(file).map_or_else(|_| "unknown".into(), |name| name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_are_found_in_order_and_files_are_no_cameras() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["video10", "video2", "video", "videox", "media0"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let names: Vec<_> = nodes(folder.path());
        assert_eq!(names, [folder.path().join("video2"), folder.path().join("video10")]);
        assert!(cameras(folder.path()).is_empty());
        assert!(cameras(&folder.path().join("none")).is_empty());
    }
}
