//! Packets of a video's codec, in the container IVF: it numbers them, so that a decoded image is known by its packet.

use anyhow::{Result, bail};
use std::io::{Result as Written, Write};

/// A codec whose videos are read packet by packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// H.264 in the byte stream of its Annex B.
    H264,
    /// H.265 in the byte stream of its Annex B.
    H265,
    /// VP9.
    Vp9,
    /// AV1 in its low-overhead form.
    Av1,
}

impl Codec {
    /// The codec that a message names: Foxglove's `h264`, `h265`, `vp9` or `av1`, or an encoder of FFmpeg's such as
    /// `hevc_nvenc`, with more behind a semicolon.
    ///
    /// # Errors
    /// When none of these is meant.
    pub fn named(name: &str) -> Result<Self> {
        let wanted = name.split(';').next().unwrap_or_default().to_ascii_lowercase();
        let known = [
            ("264", Self::H264),
            ("avc", Self::H264),
            ("265", Self::H265),
            ("hevc", Self::H265),
            ("vp9", Self::Vp9),
            ("av1", Self::Av1),
        ];
        // `hevc` holds no `avc`, and `libsvtav1` no other name.
        match known.iter().find(|(part, _)| wanted.contains(part)) {
            Some((_, codec)) => Ok(*codec),
            None => bail!("its codec '{name}' is not read; h264, h265, vp9 and av1 are"),
        }
    }

    /// FFmpeg's name of its decoder.
    pub fn decoder(self) -> &'static str {
        match self {
            Self::H264 => "h264",
            Self::H265 => "hevc",
            Self::Vp9 => "vp9",
            Self::Av1 => "av1",
        }
    }

    fn four_letters(self) -> [u8; 4] {
        *match self {
            Self::H264 => b"H264",
            Self::H265 => b"H265",
            Self::Vp9 => b"VP90",
            Self::Av1 => b"AV01",
        }
    }

    /// Whether decoding can begin with this packet: it holds a sequence parameter set (H.264, 7.4.1; H.265, 7.4.2.2),
    /// as the key frames of such messages do. For VP9 and AV1 the decoder decides itself.
    pub fn can_begin_with(self, packet: &[u8]) -> bool {
        let starts = || packet.windows(4).filter(|bytes| bytes[..3] == [0, 0, 1]).map(|bytes| bytes[3]);
        match self {
            Self::H264 => starts().any(|kind| kind & 0x1f == 7),
            Self::H265 => starts().any(|kind| (kind >> 1) & 0x3f == 33),
            Self::Vp9 | Self::Av1 => true,
        }
    }
}

/// Writes the head of a stream whose times are numbers of packets.
pub fn write_head(to: &mut impl Write, codec: Codec) -> Written<()> {
    /// A size has to stand there; the stream's own counts.
    const SIZE: [u8; 4] = [16, 0, 16, 0];
    to.write_all(b"DKIF\0\0\x20\0")?;
    to.write_all(&codec.four_letters())?;
    to.write_all(&SIZE)?;
    for number in [1u32, 1, 0, 0] {
        to.write_all(&number.to_le_bytes())?;
    }
    Ok(())
}

/// Writes a packet by its number.
pub fn write_packet(to: &mut impl Write, number: u64, packet: &[u8]) -> Written<()> {
    to.write_all(&(packet.len() as u32).to_le_bytes())?;
    to.write_all(&number.to_le_bytes())?;
    to.write_all(packet)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codecs_go_by_many_names() {
        for (name, codec) in [
            ("h264", Codec::H264),
            ("libx264;yuv420p;bgr8;bgr8", Codec::H264),
            ("h264_nvenc", Codec::H264),
            ("h265", Codec::H265),
            ("HEVC", Codec::H265),
            ("hevc_vaapi;nv12", Codec::H265),
            ("libvpx-vp9", Codec::Vp9),
            ("av1", Codec::Av1),
            ("libsvtav1", Codec::Av1),
        ] {
            assert_eq!(Codec::named(name).unwrap(), codec, "{name}");
        }
        for name in ["", "mjpeg", "png;264"] {
            assert!(Codec::named(name).is_err(), "{name}");
        }
    }

    #[test]
    fn decoding_begins_with_parameter_sets() {
        assert!(Codec::H264.can_begin_with(&[0, 0, 0, 1, 0x09, 0xf0, 0, 0, 1, 0x67, 0x42]));
        assert!(!Codec::H264.can_begin_with(&[0, 0, 0, 1, 0x41, 0x9a, 0x67]));
        assert!(Codec::H265.can_begin_with(&[0, 0, 1, 0x42, 1]));
        assert!(!Codec::H265.can_begin_with(&[0, 0, 1, 0x02, 1]));
        assert!(!Codec::H265.can_begin_with(&[0, 0, 1]));
    }
}
