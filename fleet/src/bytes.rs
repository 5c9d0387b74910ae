//! Numbers and texts as bytes, little-endian: what all messages and lists of this crate are written with.

use map::{Identity, Uuid};

/// Why bytes are not what they should be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    /// They end too early.
    #[error("it ends too early")]
    Short,
    /// There are more than there should be.
    #[error("{0} bytes too many")]
    Long(usize),
    /// A number is outside of what it may be.
    #[error("{0} may not be {1}")]
    Range(&'static str, u64),
    /// An object is of a kind that is not known here.
    #[error("objects of kind {0} are not known here\nhint: is it told by a newer version of loopbox?")]
    Kind(u8),
    /// A text is no text.
    #[error("a text is not UTF-8")]
    Text,
}

/// Writes.
#[derive(Default)]
pub struct Writer(pub Vec<u8>);

impl Writer {
    /// One byte.
    pub fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    /// Two.
    pub fn u16(&mut self, value: u16) {
        self.0.extend(value.to_le_bytes());
    }

    /// Four.
    pub fn u32(&mut self, value: u32) {
        self.0.extend(value.to_le_bytes());
    }

    /// Eight.
    pub fn u64(&mut self, value: u64) {
        self.0.extend(value.to_le_bytes());
    }

    /// One to five, the fewer the smaller it is: seven bits each, the lowest first (LEB128).
    pub fn varint(&mut self, mut value: u32) {
        while value >= 0x80 {
            self.u8(value as u8 | 0x80);
            value >>= 7;
        }
        self.u8(value as u8);
    }

    /// Bytes as they are.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.0.extend(bytes);
    }

    /// A text of at most 65,535 bytes; what is longer is cut.
    pub fn text(&mut self, text: &str) {
        let text = cut(text, usize::from(u16::MAX));
        self.u16(text.len() as u16);
        self.bytes(text.as_bytes());
    }

    /// An agent.
    pub fn identity(&mut self, identity: Identity) {
        self.bytes(identity.uuid.as_bytes());
        self.u32(identity.epoch);
    }
}

/// The beginning of a text, of at most `longest` bytes.
pub fn cut(text: &str, longest: usize) -> &str {
    let end = (0..=text.len().min(longest)).rev().find(|&end| text.is_char_boundary(end));
    &text[..end.unwrap_or(0)]
}

/// A text of another's as it can be shown: what would do something to a terminal is replaced.
pub fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c }).collect()
}

/// Reads what [`Writer`] wrote.
pub struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// Of all these bytes.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    /// As many bytes.
    ///
    /// # Errors
    /// When there are fewer.
    pub fn bytes(&mut self, count: usize) -> Result<&'a [u8], Malformed> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(Malformed::Short)?;
        self.0 = rest;
        Ok(taken)
    }

    /// So many bytes, as an array.
    ///
    /// # Errors
    /// When there are fewer.
    pub fn array<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let (taken, rest) = self.0.split_first_chunk::<N>().ok_or(Malformed::Short)?;
        self.0 = rest;
        Ok(*taken)
    }

    /// One byte.
    ///
    /// # Errors
    /// When there is none.
    pub fn u8(&mut self) -> Result<u8, Malformed> {
        Ok(u8::from_le_bytes(self.array()?))
    }

    /// Two.
    ///
    /// # Errors
    /// When there are fewer.
    pub fn u16(&mut self) -> Result<u16, Malformed> {
        Ok(u16::from_le_bytes(self.array()?))
    }

    /// Four.
    ///
    /// # Errors
    /// When there are fewer.
    pub fn u32(&mut self) -> Result<u32, Malformed> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    /// Eight.
    ///
    /// # Errors
    /// When there are fewer.
    pub fn u64(&mut self) -> Result<u64, Malformed> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    /// One to five, as [`Writer::varint`] wrote them.
    ///
    /// # Errors
    /// When there are too few, or more than a number of 32 bits has.
    pub fn varint(&mut self) -> Result<u32, Malformed> {
        let mut value = 0u64;
        for shift in (0..35).step_by(7) {
            let byte = self.u8()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return u32::try_from(value).map_err(|_| Malformed::Range("a number", value));
            }
        }
        Err(Malformed::Range("a number", value))
    }

    /// A text of at most `longest` bytes.
    ///
    /// # Errors
    /// When it is longer, cut or no text.
    pub fn text(&mut self, longest: usize) -> Result<String, Malformed> {
        let length = usize::from(self.u16()?);
        if length > longest {
            return Err(Malformed::Range("the length of a text", length as u64));
        }
        let text = std::str::from_utf8(self.bytes(length)?).map_err(|_| Malformed::Text)?;
        Ok(text.to_owned())
    }

    /// An agent.
    ///
    /// # Errors
    /// When there are too few bytes.
    pub fn identity(&mut self) -> Result<Identity, Malformed> {
        let uuid = Uuid::from_bytes(self.array()?);
        Ok(Identity { uuid, epoch: self.u32()? })
    }

    /// All that is left.
    pub fn rest(&mut self) -> &'a [u8] {
        std::mem::take(&mut self.0)
    }

    /// Whether nothing is left.
    ///
    /// # Errors
    /// When something is.
    pub fn end(self) -> Result<(), Malformed> {
        if self.0.is_empty() { Ok(()) } else { Err(Malformed::Long(self.0.len())) }
    }
}
