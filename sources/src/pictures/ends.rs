//! Whether an image file is whole, by its beginning and its end.

use super::{decode_any, jpeg};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// So much of a file's beginning tells its kind, bytes,
const HEAD: usize = 32;
/// and so much of its end whether it is all there: cameras fill their last block with zeros.
const TAIL: u64 = 4096;
/// The last chunk of a PNG (§11.2.5), which other bytes may follow.
const PNG_END: &[u8] = b"IEND\xae\x42\x60\x82";
const PNG_START: &[u8] = b"\x89PNG";
/// The kinds that are read, for people.
const KINDS: &str = "PNG, JPEG, PGM, TIFF or BMP";

/// Checks a file; the error says why it is no image.
pub fn of_file(path: &Path) -> Result<(), String> {
    let about = std::fs::metadata(path).map_err(|error| error.to_string())?;
    if about.is_dir() {
        return Err("a folder".into());
    }
    // A pipe can be read once only.
    if !about.is_file() {
        return Ok(());
    }
    let read = || -> std::io::Result<(Vec<u8>, Vec<u8>)> {
        let (mut file, mut head, mut tail) = (File::open(path)?, Vec::new(), Vec::new());
        file.by_ref().take(HEAD as u64).read_to_end(&mut head)?;
        file.seek(SeekFrom::Start(about.len().saturating_sub(TAIL)))?;
        file.read_to_end(&mut tail)?;
        Ok((head, tail))
    };
    let (head, tail) = read().map_err(|error| error.to_string())?;
    of_parts(&head, &tail)
}

/// Checks bytes; the error says why they are no image.
pub fn of_bytes(bytes: &[u8]) -> Result<(), String> {
    of_parts(&bytes[..bytes.len().min(HEAD)], &bytes[bytes.len().saturating_sub(TAIL as usize)..])
}

fn of_parts(head: &[u8], tail: &[u8]) -> Result<(), String> {
    let is_whole = match head {
        _ if head.starts_with(PNG_START) => tail.windows(PNG_END.len()).any(|end| end == PNG_END),
        _ if jpeg::is_jpeg(head) => jpeg::may_end_so(tail),
        _ if image::guess_format(head).is_ok() => true,
        // Decoding says what it is instead.
        _ => return decode_any(head, KINDS).map(drop),
    };
    if is_whole { Ok(()) } else { Err("the file is cut off: its end is missing".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::ImageFormat;
    use std::io::Cursor;

    #[test]
    fn files_that_are_cut_off_are_distinguished_from_whole_ones() {
        let image = image::GrayImage::from_fn(96, 64, |x, y| image::Luma([(x * 5 + y * y) as u8]));
        for format in
            [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::Bmp, ImageFormat::Tiff, ImageFormat::Pnm]
        {
            let mut bytes = Vec::new();
            image.write_to(&mut Cursor::new(&mut bytes), format).unwrap();
            assert_eq!(of_bytes(&bytes), Ok(()), "{format:?}");
            if matches!(format, ImageFormat::Png | ImageFormat::Jpeg) {
                assert!(
                    of_bytes(&bytes[..bytes.len() * 2 / 3]).unwrap_err().contains("cut off"),
                    "{format:?}"
                );
                // What cameras and programs leave behind the end.
                bytes.extend([0; 600]);
                assert_eq!(of_bytes(&bytes), Ok(()), "{format:?}");
            }
        }
        assert!(of_bytes(b"").unwrap_err().contains("empty"));
        assert!(of_bytes(b"<html>404</html>").unwrap_err().contains("not a PNG"));
        assert!(
            of_bytes(b"version https://git-lfs.github.com/spec/v1\noid sha256:aa\n")
                .unwrap_err()
                .contains("git lfs pull")
        );
        let room = tempfile::tempdir().unwrap();
        assert!(of_file(room.path()).is_err() && of_file(&room.path().join("none.png")).is_err());
    }
}
