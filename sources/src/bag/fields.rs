//! The header of a record: fields `name=value`.

use anyhow::{Context, Result};
use std::collections::BTreeMap;

/// Fields of a header by name.
pub struct Fields<'a>(BTreeMap<&'a [u8], &'a [u8]>);

impl<'a> Fields<'a> {
    /// Takes a header apart.
    pub fn parse(mut header: &'a [u8]) -> Result<Self> {
        let mut fields = BTreeMap::new();
        while !header.is_empty() {
            let (length, rest) = header.split_first_chunk::<4>().context("a field ends early")?;
            let length = u32::from_le_bytes(*length) as usize;
            let (field, rest) = rest.split_at_checked(length).context("a field ends early")?;
            let equals = field.iter().position(|&byte| byte == b'=').context("a field has no name")?;
            fields.insert(&field[..equals], &field[equals + 1..]);
            header = rest;
        }
        Ok(Self(fields))
    }

    fn bytes(&self, name: &str) -> Result<&'a [u8]> {
        self.0.get(name.as_bytes()).copied().with_context(|| format!("a record has no field '{name}'"))
    }

    fn array<const N: usize>(&self, name: &str) -> Result<[u8; N]> {
        self.bytes(name)?.try_into().with_context(|| format!("the field '{name}' has not {N} bytes"))
    }

    /// The kind of record.
    pub fn op(&self) -> Result<u8> {
        Ok(self.array::<1>("op")?[0])
    }

    /// A 32-bit number.
    pub fn u32(&self, name: &str) -> Result<u32> {
        Ok(u32::from_le_bytes(self.array(name)?))
    }

    /// A 64-bit number.
    pub fn u64(&self, name: &str) -> Result<u64> {
        Ok(u64::from_le_bytes(self.array(name)?))
    }

    /// A time, nanoseconds.
    pub fn time(&self, name: &str) -> Result<u64> {
        let both = self.u64(name)?;
        Ok((both & 0xffff_ffff) * 1_000_000_000 + (both >> 32))
    }

    /// A text.
    pub fn text(&self, name: &str) -> Result<String> {
        Ok(String::from_utf8_lossy(self.bytes(name)?).into_owned())
    }
}

/// Writes fields as a header or as the data of a connection, without the length before it.
pub fn format(fields: &[(&str, &[u8])]) -> Vec<u8> {
    let mut out = Vec::new();
    for (name, value) in fields {
        out.extend(((name.len() + 1 + value.len()) as u32).to_le_bytes());
        out.extend(name.as_bytes());
        out.push(b'=');
        out.extend(*value);
    }
    out
}

/// A time as a field holds it.
pub fn format_time(nanoseconds: u64) -> [u8; 8] {
    let (seconds, rest) = (nanoseconds / 1_000_000_000, nanoseconds % 1_000_000_000);
    (seconds | rest << 32).to_le_bytes()
}
