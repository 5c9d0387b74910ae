//! PCD, the point-cloud library's format: ascii, binary and compressed.

use crate::columns::{Column, Gathering, Kind, Roles};
use crate::{Scan, ScanError, lzf};

/// What the header of a PCD says.
struct Header<'a> {
    columns: Vec<Column>,
    points: usize,
    data: &'a str,
    /// Where the points begin.
    start: usize,
}

/// Reads the bytes of a PCD file; `name` is for messages, `stamp` the scan's, to which times of points relate.
///
/// # Errors
/// When header or data are not those of a PCD with x, y and z.
pub fn read_pcd(bytes: &[u8], stamp: f64, name: &str) -> Result<Scan, ScanError> {
    let header = read_header(bytes, name)?;
    let gathering = Gathering::new(Roles::find(&header.columns, name)?);
    let body = &bytes[header.start..];
    match header.data {
        "ascii" => ascii(&header, body, gathering, name),
        "binary" => binary(&header, body, gathering, name),
        "binary_compressed" => compressed(&header, body, gathering, name),
        other => Err(ScanError::format(
            name,
            format!("DATA {other} is unknown; ascii, binary and binary_compressed are read"),
        )),
    }
    .map(|gathering| gathering.finish(stamp))
}

fn read_header<'a>(bytes: &'a [u8], name: &str) -> Result<Header<'a>, ScanError> {
    let missing = |what: &str| ScanError::format(name, format!("the PCD header has no valid {what}"));
    let (mut names, mut sizes, mut types, mut counts, mut points) = (vec![], vec![], vec![], vec![], None);
    let mut start = 0;
    loop {
        let length = bytes[start..].iter().position(|&b| b == b'\n').ok_or_else(|| missing("DATA"))?;
        let line = std::str::from_utf8(&bytes[start..start + length]).map_err(|_| missing("text"))?;
        start += length + 1;
        let mut words = line.split_whitespace();
        match words.next() {
            Some("FIELDS") => names = words.map(str::to_owned).collect(),
            Some("SIZE") => sizes = words.filter_map(|w| w.parse().ok()).collect::<Vec<usize>>(),
            Some("TYPE") => types = words.map(str::to_owned).collect(),
            Some("COUNT") => counts = words.filter_map(|w| w.parse().ok()).collect::<Vec<usize>>(),
            Some("POINTS") => points = words.next().and_then(|w| w.parse::<usize>().ok()),
            Some("DATA") => {
                if counts.is_empty() {
                    counts = vec![1; names.len()];
                }
                if sizes.len() != names.len() || types.len() != names.len() || counts.len() != names.len() {
                    return Err(missing("FIELDS, SIZE, TYPE and COUNT of one length"));
                }
                let columns = names.iter().zip(&sizes).zip(&types).zip(&counts).map(
                    |(((name, &size), kind), &count)| {
                        Some(Column { name: name.clone(), kind: kind_of(kind, size)?, count })
                    },
                );
                let columns = columns.collect::<Option<_>>().ok_or_else(|| missing("TYPE and SIZE"))?;
                let data = words.next().ok_or_else(|| missing("DATA"))?;
                return Ok(Header { columns, points: points.ok_or_else(|| missing("POINTS"))?, data, start });
            }
            _ => {}
        }
    }
}

fn kind_of(kind: &str, size: usize) -> Option<Kind> {
    match (kind, size) {
        ("I", 1 | 2 | 4 | 8) => Some(Kind::Signed(size)),
        ("U", 1 | 2 | 4 | 8) => Some(Kind::Unsigned(size)),
        ("F", 4 | 8) => Some(Kind::Float(size)),
        _ => None,
    }
}

fn cut_off(header: &Header, name: &str) -> ScanError {
    ScanError::format(name, format!("the file ends before its {} points", header.points))
}

fn ascii(header: &Header, body: &[u8], mut gathering: Gathering, name: &str) -> Result<Gathering, ScanError> {
    let text = std::str::from_utf8(body)
        .map_err(|_| ScanError::format(name, "DATA ascii holds bytes that are no text"))?;
    let mut first = Vec::with_capacity(header.columns.len());
    let mut width = 0;
    for column in &header.columns {
        first.push(width);
        width += column.count;
    }
    let mut lines = text.lines().filter(|line| !line.trim().is_empty());
    let mut row = Vec::with_capacity(width);
    for _ in 0..header.points {
        let line = lines.next().ok_or_else(|| cut_off(header, name))?;
        row.clear();
        row.extend(line.split_whitespace().map(|word| word.parse::<f64>().unwrap_or(f64::NAN)));
        if row.len() < width {
            return Err(ScanError::format(name, format!("the row `{line}` has fewer than {width} numbers")));
        }
        gathering.push(|c| row[first[c]]);
    }
    Ok(gathering)
}

fn binary(
    header: &Header,
    body: &[u8],
    mut gathering: Gathering,
    name: &str,
) -> Result<Gathering, ScanError> {
    let mut first = Vec::with_capacity(header.columns.len());
    let mut width = 0usize;
    for column in &header.columns {
        first.push(width);
        width = width.saturating_add(column.kind.size().saturating_mul(column.count));
    }
    if width == 0 || header.points.checked_mul(width).is_none_or(|n| n > body.len()) {
        return Err(cut_off(header, name));
    }
    for point in body.chunks_exact(width).take(header.points) {
        gathering.push(|c| header.columns[c].kind.read(&point[first[c]..], false));
    }
    Ok(gathering)
}

/// Columns one after the other, all in one LZF block behind its two sizes.
fn compressed(
    header: &Header,
    body: &[u8],
    mut gathering: Gathering,
    name: &str,
) -> Result<Gathering, ScanError> {
    let size =
        |at: usize| body.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let block = size(0)
        .zip(size(4))
        .and_then(|(packed, unpacked)| Some((body.get(8..8usize.checked_add(packed)?)?, unpacked)));
    let (block, unpacked) = block.ok_or_else(|| cut_off(header, name))?;
    let data = lzf::decompress(block, unpacked)
        .ok_or_else(|| ScanError::format(name, "the compressed points are damaged"))?;
    let mut first = Vec::with_capacity(header.columns.len());
    let mut end = 0usize;
    for column in &header.columns {
        first.push(end);
        end =
            end.saturating_add(column.kind.size().saturating_mul(column.count).saturating_mul(header.points));
    }
    if end > data.len() {
        return Err(cut_off(header, name));
    }
    for i in 0..header.points {
        gathering.push(|c| {
            let column = &header.columns[c];
            column.kind.read(&data[first[c] + i * column.kind.size() * column.count..], false)
        });
    }
    Ok(gathering)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z ring t\nSIZE 4 4 4 2 4\nTYPE F F F U U\nCOUNT 1 1 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ";

    fn expected() -> Scan {
        Scan {
            stamp: 3.0,
            points: vec![[1.0, 2.0, -0.5], [4.0, 5.0, 6.0]],
            times: vec![0.0, 0.1],
            rings: vec![7, 300],
            stale: 0,
        }
    }

    fn rows() -> Vec<u8> {
        let mut bytes = Vec::new();
        for (p, ring, t) in [([1.0f32, 2.0, -0.5], 7u16, 0u32), ([4.0, 5.0, 6.0], 300, 100_000_000)] {
            p.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
            bytes.extend(ring.to_le_bytes());
            bytes.extend(t.to_le_bytes());
        }
        bytes
    }

    fn columns() -> Vec<u8> {
        let rows = rows();
        let at = [(0, 4), (4, 4), (8, 4), (12, 2), (14, 4)];
        at.iter()
            .flat_map(|&(o, n)| [rows[o..o + n].to_vec(), rows[18 + o..18 + o + n].to_vec()].concat())
            .collect()
    }

    /// LZF of literals only.
    fn literal(data: &[u8]) -> Vec<u8> {
        data.chunks(32).flat_map(|c| [vec![c.len() as u8 - 1], c.to_vec()].concat()).collect()
    }

    fn files() -> [Vec<u8>; 3] {
        let ascii = format!("{HEADER}ascii\n1 2 -0.5 7 0\n4 5 6 300 100000000\n").into_bytes();
        let binary = [format!("{HEADER}binary\n").into_bytes(), rows()].concat();
        let packed = literal(&columns());
        let sizes = [(packed.len() as u32).to_le_bytes(), (columns().len() as u32).to_le_bytes()].concat();
        let compressed = [format!("{HEADER}binary_compressed\n").into_bytes(), sizes, packed].concat();
        [ascii, binary, compressed]
    }

    #[test]
    fn all_three_kinds_read_the_same() {
        for file in files() {
            assert_eq!(read_pcd(&file, 3.0, "test").unwrap(), expected());
        }
    }

    #[test]
    fn no_cut_file_is_read_in_full() {
        for file in files() {
            for length in 0..file.len() - 1 {
                if let Ok(scan) = read_pcd(&file[..length], 3.0, "test") {
                    // Only the digits of an ascii number can be cut unnoticed.
                    assert!(file.ends_with(b"\n") && scan.points == expected().points, "{length}");
                }
            }
        }
    }
}
