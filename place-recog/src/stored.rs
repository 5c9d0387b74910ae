//! Features as maps keep them: the bytes of [`map::Keyframe::features`].

use crate::features::{Descriptor, Features, Keypoint};

/// The first byte: what follows is laid out so.
const LAYOUT: u8 = 1;
/// Bytes of a feature: four floats and its descriptor.
const FEATURE_BYTES: usize = 16 + size_of::<Descriptor>();

/// What bytes were that are no features.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the features of a keyframe cannot be read: {0}")]
pub struct StoredError(String);

/// The bytes of some features; the same features give the same bytes.
pub fn encode(features: &Features) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(1 + features.len() * FEATURE_BYTES);
    bytes.push(LAYOUT);
    for (keypoint, descriptor) in features.keypoints.iter().zip(&features.descriptors) {
        let Keypoint { pixel: [x, y], size, angle } = *keypoint;
        bytes.extend([x, y, size, angle].iter().flat_map(|value| value.to_le_bytes()));
        bytes.extend(descriptor);
    }
    bytes
}

/// The features of [`encode`]d bytes.
///
/// # Errors
/// When the bytes are of another layout, are cut, or hold a number that is none.
pub fn decode(bytes: &[u8]) -> Result<Features, StoredError> {
    let Some((&LAYOUT, bytes)) = bytes.split_first() else {
        return Err(StoredError("they are of a layout that this version does not know".into()));
    };
    let (each, rest) = bytes.as_chunks::<FEATURE_BYTES>();
    if !rest.is_empty() {
        return Err(StoredError(format!("{} bytes too many, or the rest is missing", rest.len())));
    }
    let mut features = Features::default();
    for bytes in each {
        let (numbers, descriptor) = bytes.split_at(16);
        let number = |i: usize| f32::from_le_bytes(std::array::from_fn(|k| numbers[4 * i + k]));
        let [x, y, size, angle] = std::array::from_fn(number);
        if ![x, y, size, angle].iter().all(|value| value.is_finite()) {
            return Err(StoredError("a key point is not finite".into()));
        }
        features.keypoints.push(Keypoint { pixel: [x, y], size, angle });
        features.descriptors.push(std::array::from_fn(|k| descriptor[k]));
    }
    Ok(features)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_come_back_and_what_is_none_is_refused() {
        let keypoint = |i: u8| Keypoint { pixel: [f32::from(i), 0.3], size: 7.5, angle: -1.0 };
        let features = Features {
            keypoints: (0..9).map(keypoint).collect(),
            descriptors: (0..9).map(|i| [i; 128]).collect(),
        };
        let bytes = encode(&features);
        assert_eq!(decode(&bytes), Ok(features));
        assert_eq!(decode(&encode(&Features::default())), Ok(Features::default()));
        assert!(
            decode(&[]).is_err() && decode(&[9, 9]).is_err() && decode(&bytes[..bytes.len() - 1]).is_err()
        );
        let mut broken = bytes;
        broken[1..5].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(decode(&broken).is_err());
    }
}
