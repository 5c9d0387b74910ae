//! The errors for inputs that are no recordings, by their first bytes or their names.

use anyhow::{Result, bail};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// Archives by what they start with, and how they are unpacked.
const ARCHIVES: [(&[u8], &str); 6] = [
    (b"PK\x03\x04", "unzip"),
    (b"\x1f\x8b", "tar -xzf"),
    (b"7z\xbc\xaf\x27\x1c", "7z x"),
    (b"Rar!", "unrar x"),
    (b"\xfd7zXZ\0", "tar -xJf"),
    (b"BZh", "tar -xjf"),
];

/// Refuses an input that is no recording, and says what to do about it.
///
/// # Errors
/// When it is an address, a pipe, an archive, a map, a video without its index, or nothing at all.
pub fn check_kind(path: &Path) -> Result<()> {
    let path_text = path.display();
    let text = path.to_string_lossy();
    if let Some((scheme, _)) = text.split_once(":/").filter(|(scheme, _)| is_scheme(scheme)) {
        bail!(
            "{path_text}: an address, and recordings are files\nhint: write what comes from there into a file first: `ffmpeg -i \
             {scheme}://… -c copy video.mkv`, or save it, and give that"
        );
    }
    let Ok(about) = std::fs::metadata(path) else {
        bail!("{path_text}: there is no such file or folder");
    };
    if about.is_dir() {
        return Ok(());
    }
    if !about.is_file() {
        bail!(
            "{path_text}: a pipe or a device, and a recording is read more than once\nhint: write it into a file first: `cat {path_text} > \
             FILE`; a camera is given as its /dev/videoN"
        );
    }
    if map::is_map_file(path) {
        bail!(
            "{path_text}: this is a map, not a recording\nhint: `loopbox info` and `loopbox export` read it"
        );
    }
    let Ok(mut file) = File::open(path) else { return Ok(()) };
    let mut start = Vec::new();
    if file.by_ref().take(16).read_to_end(&mut start).is_err() {
        return Ok(());
    }
    if start.is_empty() {
        bail!("{path_text}: the file is empty\nhint: was it copied whole?");
    }
    if let Some((_, command)) = ARCHIVES.iter().find(|(magic, _)| start.starts_with(magic)) {
        bail!(
            "{path_text}: an archive\nhint: unpack it, `{command} {path_text}`, and give the folder or the file that was in it"
        );
    }
    if start.get(4..8) == Some(b"ftyp") && !has_index(&mut file, about.len()) {
        bail!(
            "{path_text}: a video without its index (moov): its recording was not ended, or it was not copied whole\nhint: copy it \
             again; else `untrunc` makes an index by that of another video of the same camera"
        );
    }
    Ok(())
}

/// Whether this may be how an address begins: a drive has one letter.
fn is_scheme(text: &str) -> bool {
    text.len() > 1 && text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'+')
}

/// Whether an MP4 or QuickTime file has a box that says where its frames are (ISO 14496-12, §4.2): `moov`.
fn has_index(file: &mut File, size: u64) -> bool {
    /// No file has so many boxes at its top.
    const MOST_BOXES: usize = 100_000;
    let mut at = 0;
    for _ in 0..MOST_BOXES {
        let mut head = [0; 16];
        if at + 8 > size || file.seek(SeekFrom::Start(at)).is_err() || file.read(&mut head).unwrap_or(0) < 8 {
            return false;
        }
        if &head[4..8] == b"moov" {
            return true;
        }
        let [a, b, c, d, _, _, _, _, long @ ..] = head;
        let length = match u32::from_be_bytes([a, b, c, d]) {
            0 => return false,
            1 => u64::from_be_bytes(long),
            length => length.into(),
        };
        let Some(next) = at.checked_add(length.max(8)) else { return false };
        at = next;
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reported(path: &Path) -> String {
        check_kind(path).err().map_or(String::new(), |error| error.to_string())
    }

    #[test]
    fn what_is_no_recording_is_reported_with_what_to_do() {
        let room = tempfile::tempdir().unwrap();
        let file = |name: &str, bytes: &[u8]| {
            let path = room.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            path
        };
        let boxes = |names: &[&[u8; 4]]| -> Vec<u8> {
            names.iter().flat_map(|name| [&[0, 0, 0, 16][..], &name[..], &[0; 8]].concat()).collect()
        };
        for (path, expected) in [
            (file("a.mp4", &boxes(&[b"ftyp", b"mdat"])), "without its index"),
            (file("b.mov", &boxes(&[b"ftyp", b"wide", b"mdat"])), "without its index"),
            (file("whole.mp4", &boxes(&[b"ftyp", b"mdat", b"moov"])), ""),
            (file("a.zip", b"PK\x03\x04 and more"), "unzip"),
            (file("frames.tar.gz", b"\x1f\x8b\x08 and more"), "tar -xzf"),
            (file("a.7z", b"7z\xbc\xaf\x27\x1c"), "7z x"),
            (file("empty.bag", b""), "empty"),
            (file("any", b"something"), ""),
            (room.path().join("none"), "no such file"),
            ("rtsp://10.0.0.7/stream".into(), "ffmpeg -i rtsp"),
            ("http://example.org/a.mp4".into(), "an address"),
            ("udp://@:5000".into(), "an address"),
            ("/dev/null".into(), "a pipe or a device"),
            (room.path().to_owned(), ""),
        ] {
            let output = reported(&path);
            assert!(
                output.contains(expected) && (expected.is_empty() == output.is_empty()),
                "{}: {output}",
                path.display()
            );
        }
    }
}
