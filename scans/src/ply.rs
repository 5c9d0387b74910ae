//! PLY: ascii, little and big endian; the points are the element `vertex`, which must come first.

use crate::columns::{Column, Gathering, Kind, Roles};
use crate::{Scan, ScanError};

/// How the numbers stand in the file.
#[derive(Clone, Copy)]
enum Encoding {
    Ascii,
    Binary { big_endian: bool },
}

/// Reads the bytes of a PLY file; `name` is for messages, `stamp` the scan's, to which times of points relate.
///
/// # Errors
/// When header or data are not those of a PLY with x, y and z.
pub fn read_ply(bytes: &[u8], stamp: f64, name: &str) -> Result<Scan, ScanError> {
    let (encoding, columns, count, start) = read_header(bytes, name)?;
    let mut gathering = Gathering::new(Roles::find(&columns, name)?);
    let cut_off = || ScanError::format(name, format!("the file ends before its {count} points"));
    let body = &bytes[start..];
    match encoding {
        Encoding::Ascii => {
            let text = std::str::from_utf8(body)
                .map_err(|_| ScanError::format(name, "format ascii holds bytes that are no text"))?;
            let mut lines = text.lines().filter(|line| !line.trim().is_empty());
            let mut row = Vec::with_capacity(columns.len());
            for _ in 0..count {
                let line = lines.next().ok_or_else(cut_off)?;
                row.clear();
                row.extend(line.split_whitespace().map(|word| word.parse::<f64>().unwrap_or(f64::NAN)));
                if row.len() < columns.len() {
                    return Err(ScanError::format(name, format!("the row `{line}` has too few numbers")));
                }
                gathering.push(|c| row[c]);
            }
        }
        Encoding::Binary { big_endian } => {
            let offsets: Vec<usize> = columns
                .iter()
                .scan(0, |end, column| {
                    let start = *end;
                    *end += column.kind.size();
                    Some(start)
                })
                .collect();
            let width: usize = columns.iter().map(|column| column.kind.size()).sum();
            if width == 0 || count.checked_mul(width).is_none_or(|n| n > body.len()) {
                return Err(cut_off());
            }
            for point in body.chunks_exact(width).take(count) {
                gathering.push(|c| columns[c].kind.read(&point[offsets[c]..], big_endian));
            }
        }
    }
    Ok(gathering.finish(stamp))
}

type Header = (Encoding, Vec<Column>, usize, usize);

fn read_header(bytes: &[u8], name: &str) -> Result<Header, ScanError> {
    let bad = |what: &str| ScanError::format(name, format!("the PLY header {what}"));
    if !bytes.starts_with(b"ply") {
        return Err(bad("does not begin with `ply`"));
    }
    let (mut encoding, mut columns, mut count, mut start) = (None, Vec::new(), None, 0);
    let mut elements = 0;
    loop {
        let length =
            bytes[start..].iter().position(|&b| b == b'\n').ok_or_else(|| bad("has no end_header"))?;
        let line = std::str::from_utf8(&bytes[start..start + length]).map_err(|_| bad("is no text"))?;
        start += length + 1;
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["format", "ascii", ..] => encoding = Some(Encoding::Ascii),
            ["format", "binary_little_endian", ..] => encoding = Some(Encoding::Binary { big_endian: false }),
            ["format", "binary_big_endian", ..] => encoding = Some(Encoding::Binary { big_endian: true }),
            ["element", "vertex", number] => {
                elements += 1;
                if elements > 1 {
                    return Err(bad("has another element before `vertex`"));
                }
                count = number.parse().ok();
            }
            ["element", ..] => elements += 1,
            ["property", "list", ..] if elements == 1 => {
                return Err(bad("has a list among the points' properties"));
            }
            ["property", kind, column] if elements == 1 => {
                let kind = kind_of(kind).ok_or_else(|| bad("has a property of unknown type"))?;
                columns.push(Column { name: (*column).to_owned(), kind, count: 1 });
            }
            ["end_header"] => {
                let encoding = encoding.ok_or_else(|| bad("has no known format"))?;
                return Ok((encoding, columns, count.ok_or_else(|| bad("has no element `vertex`"))?, start));
            }
            _ => {}
        }
    }
}

fn kind_of(name: &str) -> Option<Kind> {
    Some(match name {
        "char" | "int8" => Kind::Signed(1),
        "uchar" | "uint8" => Kind::Unsigned(1),
        "short" | "int16" => Kind::Signed(2),
        "ushort" | "uint16" => Kind::Unsigned(2),
        "int" | "int32" => Kind::Signed(4),
        "uint" | "uint32" => Kind::Unsigned(4),
        "float" | "float32" => Kind::Float(4),
        "double" | "float64" => Kind::Float(8),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(format: &str) -> String {
        format!(
            "ply\nformat {format} 1.0\ncomment made here\nelement vertex 2\nproperty float x\nproperty float y\nproperty double z\nproperty uchar ring\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
        )
    }

    #[test]
    fn all_three_kinds_read_the_same() {
        let expected = vec![[1.0f32, 2.0, 3.0], [-4.0, 5.5, 6.0]];
        let ascii = [header("ascii"), "1 2 3 0\n-4 5.5 6 9\n".into()].concat().into_bytes();
        let (mut little, mut big) =
            (header("binary_little_endian").into_bytes(), header("binary_big_endian").into_bytes());
        for (p, ring) in expected.iter().zip([0u8, 9]) {
            for v in &p[..2] {
                little.extend(v.to_le_bytes());
                big.extend(v.to_be_bytes());
            }
            little.extend(f64::from(p[2]).to_le_bytes());
            big.extend(f64::from(p[2]).to_be_bytes());
            little.push(ring);
            big.push(ring);
        }
        for file in [ascii, little.clone(), big] {
            let scan = read_ply(&file, 0.0, "test").unwrap();
            assert_eq!((scan.points, scan.rings), (expected.clone(), vec![0, 9]));
        }
        for length in 0..little.len() {
            assert!(read_ply(&little[..length], 0.0, "test").is_err(), "{length}");
        }
    }
}
