//! Numbers off the wire, as ROS 1 and CDR put them there.

use super::Encoding;

/// Reads on and on; `None` where the bytes end.
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Numbers lie at multiples of their size.
    aligned: bool,
    big_endian: bool,
    ros1: bool,
}

impl<'a> Reader<'a> {
    /// At the start of a message; `None` when CDR's own header is missing.
    pub fn new(encoding: Encoding, bytes: &'a [u8]) -> Option<Self> {
        if encoding == Encoding::Ros1 {
            return Some(Self { bytes, at: 0, aligned: false, big_endian: false, ros1: true });
        }
        // Two bytes say how numbers are put together, the lowest bit of the second little-endian.
        let (header, body) = bytes.split_at_checked(4)?;
        let big_endian = header[1] & 1 == 0;
        Some(Self { bytes: body, at: 0, aligned: true, big_endian, ros1: false })
    }

    /// The next bytes.
    pub fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let end = self.at.checked_add(count)?;
        let found = self.bytes.get(self.at..end)?;
        self.at = end;
        Some(found)
    }

    /// Moves on to a multiple of a size.
    pub fn align(&mut self, size: usize) {
        if self.aligned {
            self.at = self.at.next_multiple_of(size);
        }
    }

    fn number<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.align(N);
        let mut raw: [u8; N] = self.take(N)?.try_into().ok()?;
        if self.big_endian {
            raw.reverse();
        }
        Some(raw)
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.number().map(u8::from_le_bytes)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.number().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.number().map(u64::from_le_bytes)
    }

    pub fn f32(&mut self) -> Option<f32> {
        self.number().map(f32::from_le_bytes)
    }

    /// A text; what is no UTF-8 in it is replaced.
    pub fn string(&mut self) -> Option<String> {
        let length = self.u32()? as usize;
        let bytes = self.take(length)?;
        // CDR counts a NUL at the end.
        let bytes = if self.ros1 { bytes } else { bytes.strip_suffix(&[0]).unwrap_or(bytes) };
        Some(String::from_utf8_lossy(bytes).into_owned())
    }

    /// A `std_msgs/Header`: its stamp, seconds.
    pub fn header(&mut self) -> Option<f64> {
        if self.ros1 {
            self.u32()?;
        }
        let seconds = self.u32()?;
        let nanoseconds = self.u32()?;
        self.string()?;
        // ROS 2 has signed seconds; no recording is older than 1970.
        Some(f64::from(seconds) + f64::from(nanoseconds) * 1e-9)
    }
}
