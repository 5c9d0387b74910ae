use super::writer::calibration_message;
use super::*;
use crate::correction::CameraOptions;
use crate::pictures::Picture;
use crate::{FoundCalibration, FrameSource, SourceFrame, SourceOptions, messages, time};
use calib::Imagery;
use geometry::{Camera, Distortion, Fov, KannalaBrandt, Pinhole, RadTan};
use std::io::Cursor;

const STAMPS: [f64; 5] = [0.0, 0.1, 0.30000000000000004, 7.123456789, 1403636579.7635555];

fn lenses() -> Vec<Distortion> {
    let terms = [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-5, 1.0 / 3.0, 1e-17, -0.1, 0.7];
    vec![
        Distortion::None,
        Distortion::RadTan(RadTan::new(&[0.0; 5]).unwrap()),
        Distortion::RadTan(RadTan::new(&terms[..4]).unwrap()),
        Distortion::RadTan(RadTan::new(&terms[..5]).unwrap()),
        Distortion::RadTan(RadTan::new(&terms).unwrap()),
        Distortion::KannalaBrandt(KannalaBrandt::new(&terms[..4]).unwrap()),
        Distortion::Fov(Fov::new(&[0.1 + 0.8]).unwrap()),
    ]
}

fn camera(lens: Distortion) -> Camera {
    let pinhole = Pinhole { width: 96, height: 64, fx: 80.1, fy: 1e2 / 3.0, cx: 47.5, cy: 31.0 + 1e-13 };
    Camera::new(pinhole, lens).unwrap()
}

fn named(name: &str, bytes: &[u8]) -> Option<NamedFile> {
    Some(NamedFile { name: name.into(), bytes: bytes.into() })
}

fn picture(index: u64) -> EncodedPicture {
    EncodedPicture { format: "jpeg", bytes: vec![index as u8; 500 + index as usize % 7] }
}

/// A recording in memory, and its length with the frames in it after each flush.
fn recording(head: &Head, frames: u64, dropped: &[u64]) -> (Vec<u8>, Vec<(usize, u64)>) {
    let mut bytes = Cursor::new(Vec::new());
    let mut flushed = Vec::new();
    let mut writer = RecordingWriter::create(&mut bytes, head).unwrap();
    for index in 0..frames {
        writer.frame(index, 5.0 + index as f64 * 0.1, picture(index)).unwrap();
        if dropped.contains(&index) {
            writer.dropped(index).unwrap();
        }
        if index % 3 == 2 {
            writer.flush().unwrap();
            flushed.push(index + 1);
        }
    }
    // Where each flush ended shows in the index.
    let summary = {
        writer.finish(0).unwrap();
        drop(writer);
        mcap::Summary::read(bytes.get_ref()).unwrap().unwrap()
    };
    let ends = summary.chunk_indexes.iter().map(|chunk| chunk.chunk_start_offset + chunk.chunk_length);
    // The first chunk holds the channels alone.
    let ends: Vec<usize> = ends.skip(1).map(|end| end as usize).collect();
    (bytes.into_inner(), ends.into_iter().zip(flushed).collect())
}

fn open(bytes: &[u8], all_frames: bool) -> Box<dyn FrameSource> {
    crate::open_bytes(bytes, &SourceOptions { all_frames, ..SourceOptions::default() }).unwrap()
}

fn frames(source: &mut dyn FrameSource) -> Vec<SourceFrame> {
    std::iter::from_fn(|| source.next_frame()).collect()
}

fn indices(source: &mut dyn FrameSource) -> Vec<u64> {
    frames(source).iter().map(|frame| frame.index).collect()
}

fn bytes_of(frame: SourceFrame) -> Vec<u8> {
    match frame.picture {
        Picture::Encoded(bytes) => bytes,
        other => panic!("{other:?}"),
    }
}

#[test]
fn stamps_and_pictures_come_back_bit_for_bit() {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = RecordingWriter::create(&mut bytes, &Head::default()).unwrap();
    for (i, stamp) in STAMPS.into_iter().enumerate() {
        writer.frame(7 + i as u64, stamp, picture(i as u64)).unwrap();
    }
    assert!(writer.frame(99, -1.0, picture(0)).is_err());
    writer.finish(0).unwrap();
    drop(writer);
    let input = crate::Input::Memory("memory".into(), bytes.into_inner().into());
    let mut source = crate::mcap_recording::open(input, &SourceOptions::default()).unwrap();
    assert_eq!(source.info().frame_count, Some(5));
    for (i, frame) in frames(source.as_mut()).into_iter().enumerate() {
        assert_eq!(frame.index, i as u64);
        assert_eq!(frame.timestamp.to_bits(), time::on_grid(STAMPS[i]).to_bits(), "{}", STAMPS[i]);
        assert_eq!(bytes_of(frame), picture(i as u64).bytes);
    }
}

#[test]
fn every_lens_comes_back_exactly_from_file_and_message() {
    for lens in lenses() {
        let camera = camera(lens);
        let text = calib::format_camera(&camera, None);
        let (response, vignette) = (named("pcalib.txt", b"0 1 2"), named("v.png", &[1, 2]));
        let calibration = CalibrationFiles { camera: named("cam.yaml", text.as_bytes()), response, vignette };
        let head = Head { calibration: calibration.clone(), ..Head::default() };
        let (bytes, _) = recording(&head, 1, &[]);
        let source = open(&bytes, false);
        let Some(FoundCalibration::Recorded { files, .. }) = &source.info().calibration else { panic!() };
        assert_eq!(**files, calibration);
        assert_eq!(files.camera().unwrap().unwrap().camera, camera);
        // A recording of a replay has the same files.
        let again = CalibrationFiles::gather(&CameraOptions::default(), source.info()).unwrap();
        assert_eq!(again, calibration);
        // Other tools go by the message.
        let mut message = Vec::new();
        foxglove::Encode::encode(&calibration_message(&camera, 5), &mut message).unwrap();
        let info = messages::read_calibration(messages::Form::FoxgloveCalibration, &message).unwrap();
        assert_eq!(info.camera(Imagery::Raw, "the message").unwrap(), Some(camera));
    }
}

#[test]
fn a_replay_leaves_out_what_the_run_dropped() {
    let (whole, ends) = recording(&Head::default(), 12, &[0, 4, 5, 11]);
    let kept = [1, 2, 3, 6, 7, 8, 9, 10];
    let mut source = open(&whole, false);
    assert_eq!(source.info().frame_count, Some(8));
    assert_eq!(indices(source.as_mut()), kept);
    assert!(source.facts().iter().any(|(label, text)| *label == "dropped" && text.contains("0,4-5,11")));
    assert_eq!(indices(open(&whole, true).as_mut()), (0..12).collect::<Vec<_>>());
    // Without an end, the messages say so.
    let (end, _) = ends[3];
    let mut torn = open(&whole[..end], false);
    assert_eq!(indices(torn.as_mut()), kept);
    assert!(torn.warning().unwrap().contains("ends early"));
}

#[test]
fn a_file_cut_anywhere_gives_back_what_was_flushed() {
    let (whole, ends) = recording(&Head::default(), 60, &[]);
    let mut random = geometry::Random::new(12345);
    for _ in 0..100 {
        let length = random.index(whole.len());
        let flushed =
            ends.iter().filter(|(end, _)| *end <= length).map(|(_, frames)| *frames).max().unwrap_or(0);
        let opened = crate::open_bytes(&whole[..length], &SourceOptions::default());
        let Ok(mut source) = opened else {
            assert_eq!(flushed, 0, "{length} bytes");
            continue;
        };
        let read = frames(source.as_mut());
        assert!(read.len() as u64 >= flushed, "{} of {flushed} frames in {length} bytes", read.len());
        for (i, frame) in read.into_iter().enumerate() {
            assert_eq!(bytes_of(frame), picture(i as u64).bytes);
        }
    }
}

#[test]
fn damaged_bytes_are_read_or_refused() {
    let (whole, _) = recording(&Head::default(), 9, &[4]);
    let mut random = geometry::Random::new(99);
    for _ in 0..400 {
        let mut bytes = whole.clone();
        for _ in 0..3 {
            let at = random.index(bytes.len());
            bytes[at] = random.bits() as u8;
        }
        if let Ok(mut source) = crate::open_bytes(&bytes, &SourceOptions::default()) {
            let _ = (source.skip_to(0.5), frames(source.as_mut()).len(), source.facts());
        }
    }
}

#[test]
fn seeking_gives_what_reading_gives() {
    let (whole, ends) = recording(&Head::default(), 60, &[31, 33]);
    for start in [0.1, 2.95, 3.0, 3.2, 5.9, 8.0] {
        let mut source = open(&whole, false);
        assert_eq!(source.skip_to(start), Some(5.0));
        let searched: Vec<(u64, u64)> =
            frames(source.as_mut()).iter().map(|f| (f.index, f.timestamp.to_bits())).collect();
        let all = frames(open(&whole, false).as_mut());
        let read = all.iter().filter(|f| f.timestamp - 5.0 >= start - 1e-9);
        assert_eq!(searched, read.map(|f| (f.index, f.timestamp.to_bits())).collect::<Vec<_>>(), "{start}");
    }
    // Without an index there is nothing to seek by, and nothing is lost.
    let mut torn = open(&whole[..ends[9].0], false);
    assert_eq!(torn.skip_to(1.0), None);
    assert_eq!(indices(torn.as_mut()).len(), 30);
}

fn raw_frame(index: u64) -> SourceFrame {
    let picture = Picture::Encoded(picture(index).bytes);
    SourceFrame { index, timestamp: index as f64 * 0.1, captured: None, picture }
}

#[test]
fn a_recorder_starts_and_stops_within_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.mcap");
    let recorder = Recorder::idle();
    assert!(recorder.stop().is_err() && !recorder.is_recording());
    recorder.frame(&raw_frame(0));
    recorder.start(&path, &Head::default()).unwrap();
    assert!(recorder.start(&folder.path().join("s.mcap"), &Head::default()).is_err());
    let clone = recorder.clone();
    (10..20).for_each(|i| clone.frame(&raw_frame(i)));
    clone.frame_waiting(&SourceFrame { picture: Picture::Broken("torn".into()), ..raw_frame(20) });
    clone.frame(&SourceFrame { timestamp: f64::NAN, ..raw_frame(21) });
    [9, 12, 12].into_iter().for_each(|index| clone.dropped(index));
    assert!(recorder.is_recording());
    let summary = recorder.stop().unwrap();
    assert_eq!((summary.frames, summary.dropped, summary.left_out), (10, 1, 0));
    assert_eq!(summary.unreadable, (2, Some("torn".into())));
    assert!(recorder.start(&path, &Head::default()).unwrap_err().to_string().contains("already"));
    let mut source = crate::open(&path, &SourceOptions::default()).unwrap();
    assert_eq!(indices(source.as_mut()), [0, 1, 3, 4, 5, 6, 7, 8, 9]);
    // Dropped without being stopped, it ends the file well.
    let second = folder.path().join("second.mcap");
    recorder.start(&second, &Head::default()).unwrap();
    recorder.frame(&raw_frame(5));
    drop((recorder, clone));
    let mut source = crate::open(&second, &SourceOptions::default()).unwrap();
    assert_eq!((indices(source.as_mut()), source.warning()), (vec![0], None));
}
