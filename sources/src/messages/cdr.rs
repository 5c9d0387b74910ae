//! The Common Data Representation of ROS 2 messages (OMG DDS-XTypes 1.3, §7.4).

use anyhow::{Context, Result, bail};

const ENDS_EARLY: &str = "the message ends early";

/// Reads the plain types of a CDR-encoded message in order.
pub struct Cdr<'a> {
    /// What follows the four bytes that name the encoding; alignment counts from here.
    body: &'a [u8],
    position: usize,
    big_endian: bool,
    /// 8 in version 1, 4 in version 2.
    largest_alignment: usize,
}

impl<'a> Cdr<'a> {
    /// Starts reading a message.
    ///
    /// # Errors
    /// When it is not plain CDR, version 1 or 2.
    pub fn new(message: &'a [u8]) -> Result<Self> {
        let (&[0, kind, _, _], body) = message.split_first_chunk::<4>().context(ENDS_EARLY)? else {
            bail!("the message does not start as CDR does");
        };
        let (big_endian, largest_alignment) = match kind {
            0 => (true, 8),
            1 => (false, 8),
            6 => (true, 4),
            7 => (false, 4),
            other => bail!("CDR encoding {other} is not plain"),
        };
        Ok(Self { body, position: 0, big_endian, largest_alignment })
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        let bytes = self.body.get(self.position..).and_then(|rest| rest.get(..count)).context(ENDS_EARLY)?;
        self.position += count;
        Ok(bytes)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N]> {
        self.position = self.position.next_multiple_of(N.min(self.largest_alignment));
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    /// A byte.
    pub fn u8(&mut self) -> Result<u8> {
        Ok(u8::from_le_bytes(self.number()?))
    }

    /// An unsigned 32-bit number.
    pub fn u32(&mut self) -> Result<u32> {
        Ok(u32::from_le_bytes(self.number()?))
    }

    /// A signed 32-bit number.
    pub fn i32(&mut self) -> Result<i32> {
        Ok(i32::from_le_bytes(self.number()?))
    }

    /// An unsigned 64-bit number.
    pub fn u64(&mut self) -> Result<u64> {
        Ok(u64::from_le_bytes(self.number()?))
    }

    /// A 64-bit float.
    pub fn f64(&mut self) -> Result<f64> {
        Ok(f64::from_le_bytes(self.number()?))
    }

    /// A string.
    pub fn string(&mut self) -> Result<String> {
        let bytes = self.bytes()?;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        Ok(String::from_utf8_lossy(text).into_owned())
    }

    /// A sequence of bytes.
    pub fn bytes(&mut self) -> Result<&'a [u8]> {
        let count = self.u32()? as usize;
        self.take(count)
    }

    /// A sequence of 64-bit floats.
    pub fn f64_sequence(&mut self) -> Result<Vec<f64>> {
        let count = self.u32()? as usize;
        // A damaged count must not ask for more memory than the message could fill.
        if count > self.body.len() / 8 {
            bail!(ENDS_EARLY);
        }
        (0..count).map(|_| self.f64()).collect()
    }
}
