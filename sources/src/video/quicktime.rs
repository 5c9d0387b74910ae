//! The lens by a video's metadata: telephones write its focal length into MP4 and QuickTime files.
//!
//! A file is boxes in boxes (ISO/IEC 14496-12, §4.2; QuickTime File Format, *Atoms*). A metadata box lists its keys in `keys`
//! and their values, by number, in `ilst` (QuickTime File Format, *Metadata*).

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// The key of the length that has the same view on 35 mm film, as Apple's telephones write it.
const KEY: &[u8] = b"com.apple.quicktime.camera.focal_length.35mm_equivalent";
/// More than this no box of metadata has; images and sound are in others.
const MAX_BYTES: u64 = 1 << 20;
/// Deeper than this no metadata lie: `moov`, `trak`, `meta`.
const MAX_DEPTH: usize = 3;

/// The focal length that a video's metadata state as that of 35 mm film, millimetres; `None` where they do not, or it is no
/// such file.
pub fn focal_on_film(path: &Path) -> Option<f64> {
    let file = File::open(path).ok()?;
    let end = file.metadata().ok()?.len();
    find(&mut BufReader::new(file), 0, end, MAX_DEPTH)
}

/// Looks through the boxes from `start` to `end`.
fn find(file: &mut (impl Read + Seek), start: u64, end: u64, depth: usize) -> Option<f64> {
    let mut at = start;
    while at.checked_add(8)? <= end {
        file.seek(SeekFrom::Start(at)).ok()?;
        let mut head = [0; 8];
        file.read_exact(&mut head).ok()?;
        let (size, kind) = (u64::from(word(&head, 0)?), &head[4..]);
        // 1: the size follows as 64 bits; 0: to the end.
        let (size, header) = match size {
            0 => (end - at, 8),
            1 => {
                let mut large = [0; 8];
                file.read_exact(&mut large).ok()?;
                (u64::from_be_bytes(large), 16)
            }
            size => (size, 8),
        };
        let next = at.checked_add(size).filter(|next| size >= header && *next <= end)?;
        let inside = at + header;
        let found = match kind {
            b"moov" | b"trak" | b"udta" if depth > 0 => find(file, inside, next, depth - 1),
            b"meta" if next - inside <= MAX_BYTES => {
                file.seek(SeekFrom::Start(inside)).ok()?;
                let mut bytes = vec![0; (next - inside) as usize];
                file.read_exact(&mut bytes).ok()?;
                in_metadata(&bytes)
            }
            _ => None,
        };
        if found.is_some() {
            return found;
        }
        at = next;
    }
    None
}

/// The length in the content of a metadata box.
fn in_metadata(bytes: &[u8]) -> Option<f64> {
    // In MP4, not in QuickTime, version and flags come first.
    let boxes = if bytes.get(4..8)? == b"hdlr" { bytes } else { bytes.get(4..)? };
    let keys = child(boxes, b"keys")?;
    let mut rest = keys.get(8..)?;
    let mut number = 0;
    loop {
        number += 1;
        let size = word(rest, 0)? as usize;
        if rest.get(8..size)? == KEY {
            break;
        }
        rest = rest.get(size.max(8)..)?;
    }
    let item = child(child(boxes, b"ilst")?, &u32::to_be_bytes(number))?;
    value(child(item, b"data")?).filter(|mm| mm.is_finite() && *mm > 0.0)
}

/// The content of the first box of a kind.
fn child<'a>(mut boxes: &'a [u8], kind: &[u8; 4]) -> Option<&'a [u8]> {
    loop {
        let size = word(boxes, 0)? as usize;
        if boxes.get(4..8)? == kind {
            return boxes.get(8..size);
        }
        boxes = boxes.get(size.max(8)..)?;
    }
}

/// A value, after its type and its language (QuickTime File Format, *Well-known types*).
fn value(data: &[u8]) -> Option<f64> {
    let raw = data.get(8..)?;
    let signed = || -> Option<i64> {
        let first = *raw.first()?;
        let start = if first & 0x80 == 0 { 0 } else { -1 };
        (raw.len() <= 8).then(|| raw.iter().fold(start, |sum, byte| sum << 8 | i64::from(*byte)))
    };
    match word(data, 0)? {
        1 => std::str::from_utf8(raw).ok()?.trim().parse().ok(),
        21 | 65..=67 | 74 => Some(signed()? as f64),
        22 | 75..=78 if raw.len() < 8 => {
            Some(raw.iter().fold(0u64, |sum, byte| sum << 8 | u64::from(*byte)) as f64)
        }
        23 => Some(f32::from_be_bytes(raw.try_into().ok()?).into()),
        24 => Some(f64::from_be_bytes(raw.try_into().ok()?)),
        _ => None,
    }
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    fn boxed(kind: &[u8], content: &[&[u8]]) -> Vec<u8> {
        let content = content.concat();
        [&(content.len() as u32 + 8).to_be_bytes()[..], kind, &content].concat()
    }

    /// Metadata with two keys, of which the second is the length, in a value of this type.
    fn metadata(version: &[u8], kind: u32, value: &[u8]) -> Vec<u8> {
        let entry = |key: &[u8]| boxed(b"mdta", &[key]);
        let item = |number: u32, kind: u32, value: &[u8]| {
            boxed(&number.to_be_bytes(), &[&boxed(b"data", &[&kind.to_be_bytes(), &[0; 4], value])])
        };
        let keys =
            boxed(b"keys", &[&[0; 4], &2u32.to_be_bytes(), &entry(b"com.apple.quicktime.make"), &entry(KEY)]);
        let list = boxed(b"ilst", &[&item(1, 1, b"Apple"), &item(2, kind, value)]);
        boxed(b"meta", &[version, &boxed(b"hdlr", &[&[0; 24]]), &keys, &list])
    }

    fn found(file: &[u8]) -> Option<f64> {
        find(&mut Cursor::new(file), 0, file.len() as u64, MAX_DEPTH)
    }

    #[test]
    fn the_length_is_found_wherever_it_is_written() {
        let kinds: [(u32, &[u8], f64); 5] = [
            (21, &26i32.to_be_bytes(), 26.0),
            (22, &[28], 28.0),
            (23, &25.5f32.to_be_bytes(), 25.5),
            (24, &13.0f64.to_be_bytes(), 13.0),
            (1, b"24", 24.0),
        ];
        for (kind, value, mm) in kinds {
            let quicktime = boxed(b"moov", &[&boxed(b"mvhd", &[&[0; 100]]), &metadata(&[], kind, value)]);
            assert_eq!(found(&quicktime), Some(mm));
            let of_track = boxed(b"moov", &[&boxed(b"trak", &[&metadata(&[0; 4], kind, value)])]);
            // Images first, with a size of 64 bits.
            let images = [&1u32.to_be_bytes()[..], b"mdat", &24u64.to_be_bytes(), &[7; 8]].concat();
            assert_eq!(found(&[images, of_track].concat()), Some(mm));
        }
    }

    #[test]
    fn files_that_say_nothing_or_are_broken_say_nothing() {
        let whole = boxed(b"moov", &[&metadata(&[], 21, &26i32.to_be_bytes())]);
        for length in 0..whole.len() {
            assert_eq!(found(&whole[..length]), None, "cut at {length}");
        }
        for at in 0..whole.len() {
            for byte in [0, 1, 0x80, 0xff] {
                let mut bytes = whole.clone();
                bytes[at] = byte;
                // Whatever comes of it, it ends.
                let _ = found(&bytes);
            }
        }
        assert_eq!(found(&boxed(b"moov", &[&metadata(&[], 21, &0i32.to_be_bytes())])), None);
        assert_eq!(found(&boxed(b"moov", &[&metadata(&[], 99, &[1; 4])])), None);
        assert_eq!(found(b"neither of the two"), None);
    }
}
