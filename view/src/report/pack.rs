//! Number arrays as base64 text: little-endian, as the typed arrays of browsers read them.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::{Serialize, Serializer};

/// Bytes that serialise as base64.
#[derive(Clone, Debug, PartialEq)]
pub struct Packed(pub Vec<u8>);

impl Packed {
    /// An array of 64-bit floats.
    pub fn f64(values: impl IntoIterator<Item = f64>) -> Self {
        Self(values.into_iter().flat_map(f64::to_le_bytes).collect())
    }

    /// An array of 32-bit floats.
    pub fn f32(values: impl IntoIterator<Item = f32>) -> Self {
        Self(values.into_iter().flat_map(f32::to_le_bytes).collect())
    }

    /// An array of 32-bit unsigned integers.
    pub fn u32(values: impl IntoIterator<Item = u32>) -> Self {
        Self(values.into_iter().flat_map(u32::to_le_bytes).collect())
    }
}

impl Serialize for Packed {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&STANDARD.encode(&self.0))
    }
}
