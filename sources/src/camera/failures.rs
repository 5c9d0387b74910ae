//! Why a camera cannot be used, and how to fix it.

use super::list;
use anyhow::{Error, anyhow};
use std::io;
use std::path::{Path, PathBuf};

/// Why a device could not be opened or set up, for people.
pub fn explain(path: &Path, error: &io::Error) -> Error {
    let name = path.display();
    match error.raw_os_error() {
        Some(libc::ENOENT) => anyhow!("{name}: there is no such device\n{}", cameras_there_are()),
        Some(libc::ENODEV | libc::ENXIO) => {
            anyhow!("{name}: no camera answers there\n{}", cameras_there_are())
        }
        Some(libc::EACCES | libc::EPERM) => anyhow!(
            "{name}: no permission to use the camera\nhint: `sudo usermod -aG video $USER`, then log in again; or \
             give this program access to {name}"
        ),
        Some(libc::EBUSY) => busy(path, &holders(Path::new("/proc"), path)),
        // What files and other devices say to the calls of V4L2.
        Some(libc::ENOTTY | libc::EINVAL | libc::EISDIR) => not_a_camera(path),
        Some(libc::ENOSPC) => anyhow!(
            "{name}: the USB bus has no bandwidth left for the camera\nhint: plug it into another port, or ask for \
             less with --size, --fps or --format MJPG"
        ),
        _ => anyhow!("{name}: the camera cannot be used: {error}"),
    }
}

/// The device is there, but gives no images.
pub fn not_a_camera(path: &Path) -> Error {
    anyhow!("{}: this is not a camera that images can be taken from\n{}", path.display(), cameras_there_are())
}

fn cameras_there_are() -> String {
    hint_of(&list::cameras(Path::new("/dev")))
}

fn hint_of(cameras: &[list::FoundCamera]) -> String {
    let names: Vec<String> =
        cameras.iter().map(|found| format!("{} ({})", found.path.display(), found.name)).collect();
    match names.as_slice() {
        [] => format!("hint: {}", list::NONE_HINT),
        names => format!("hint: cameras here: {}", names.join(", ")),
    }
}

fn busy(path: &Path, holders: &[String]) -> Error {
    let name = path.display();
    match holders {
        [] => anyhow!(
            "{name}: another program uses the camera\nhint: end it (`sudo fuser -v {name}` names it), or take another \
             camera (`loopbox cameras`)"
        ),
        holders => anyhow!(
            "{name}: the camera is in use by {}\nhint: end that program, or take another camera (`loopbox cameras`)",
            holders.join(", ")
        ),
    }
}

/// The other processes that have `device` open, as far as `proc` shows: `zoom (process 1234)`.
fn holders(proc: &Path, device: &Path) -> Vec<String> {
    let device = device.canonicalize().unwrap_or_else(|_| device.to_owned());
    let entries = std::fs::read_dir(proc).into_iter().flatten().flatten();
    let mut ids: Vec<u32> = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect();
    ids.retain(|&id| id != std::process::id() && holds(&proc.join(id.to_string()), &device));
    ids.sort_unstable();
    ids.into_iter()
        .map(|id| {
            let name = std::fs::read_to_string(proc.join(format!("{id}/comm"))).unwrap_or_default();
            format!("{} (process {id})", name.trim())
        })
        .collect()
}

fn holds(process: &Path, device: &Path) -> bool {
    let open = std::fs::read_dir(process.join("fd")).into_iter().flatten().flatten();
    open.filter_map(|entry| std::fs::read_link(entry.path()).ok()).any(|target: PathBuf| target == device)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn each_failure_names_its_mending() {
        let says =
            |code| format!("{:#}", explain(Path::new("/dev/video77"), &io::Error::from_raw_os_error(code)));
        assert!(says(libc::EACCES).contains("usermod -aG video"));
        assert!(says(libc::EBUSY).contains("another program"));
        assert!(says(libc::ENOENT).contains("no such device\nhint: "));
        assert!(says(libc::ENOTTY).contains("not a camera"));
        assert!(says(libc::ENOSPC).contains("MJPG"));
        assert!(says(libc::EIO).contains("/dev/video77"));
    }

    #[test]
    fn a_missing_device_names_those_there_are() {
        let found = list::FoundCamera {
            path: "/dev/video2".into(),
            name: "Webcam".into(),
            details: Err("busy".into()),
        };
        assert_eq!(hint_of(&[found]), "hint: cameras here: /dev/video2 (Webcam)");
        assert!(hint_of(&[]).contains("uvcvideo"));
    }

    #[test]
    fn who_holds_a_device_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let device = folder.path().join("video0");
        std::fs::write(&device, "").unwrap();
        for (id, name, target) in [(7, "zoom\n", Some(&device)), (8, "other\n", None)] {
            let process = folder.path().join(format!("proc/{id}"));
            std::fs::create_dir_all(process.join("fd")).unwrap();
            std::fs::write(process.join("comm"), name).unwrap();
            if let Some(target) = target {
                symlink(target.canonicalize().unwrap(), process.join("fd/3")).unwrap();
            }
        }
        let holders = holders(&folder.path().join("proc"), &device);
        assert_eq!(holders, ["zoom (process 7)"]);
        assert!(busy(&device, &holders).to_string().contains("in use by zoom (process 7)\nhint:"));
    }
}
