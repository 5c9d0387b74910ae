//! Decompression of LZF, the compression inside PCD's `binary_compressed`.
//!
//! A control byte below 32 announces that many literal bytes plus one; any other a copy: its top three bits are the
//! length less two (7: one more byte follows to be added), the rest and the byte after it the distance less one.

/// Decompresses into exactly `size` bytes; `None` when the data do not make that.
pub(crate) fn decompress(data: &[u8], size: usize) -> Option<Vec<u8>> {
    // A copy takes three bytes and makes 264 at most: an honest size is bounded by the data's.
    if size > data.len().saturating_mul(264) {
        return None;
    }
    let mut out = Vec::with_capacity(size);
    let mut bytes = data.iter().map(|&b| b as usize);
    while let Some(control) = bytes.next() {
        if control < 32 {
            for _ in 0..=control {
                out.push(bytes.next()? as u8);
            }
        } else {
            let length = match control >> 5 {
                7 => 7 + bytes.next()?,
                short => short,
            } + 2;
            let distance = ((control & 31) << 8) + bytes.next()? + 1;
            let start = out.len().checked_sub(distance)?;
            for i in start..start + length {
                out.push(out[i]);
            }
        }
        if out.len() > size {
            return None;
        }
    }
    (out.len() == size).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::decompress;

    #[test]
    fn copies_may_overlap_what_they_write() {
        // "ab", then 7 bytes from 2 back, then "!".
        let data = [1, b'a', b'b', 5 << 5, 1, 0, b'!'];
        assert_eq!(decompress(&data, 10).unwrap(), b"ababababa!");
        // A long copy: 7 + 3 + 2 bytes from 1 back.
        assert_eq!(decompress(&[0, b'x', 7 << 5, 3, 0], 13).unwrap(), vec![b'x'; 13]);
    }

    #[test]
    fn damaged_data_are_refused() {
        assert_eq!(decompress(&[3, b'a'], 4), None);
        assert_eq!(decompress(&[1 << 5, 9], 3), None);
        assert_eq!(decompress(&[0, b'x'], 2), None);
        assert_eq!(decompress(&[0, b'x'], usize::MAX), None);
    }
}
