use super::*;

/// A camera with these controls; those in `broken` cannot be set.
#[derive(Default)]
struct Fake {
    values: Mutex<BTreeMap<u32, i32>>,
    broken: Vec<u32>,
}

impl Fake {
    fn new(values: &[(u32, i32)]) -> Arc<Self> {
        Arc::new(Self { values: Mutex::new(values.iter().copied().collect()), broken: vec![] })
    }

    fn value(&self, id: u32) -> i32 {
        self.values.lock().unwrap()[&id]
    }
}

impl Controls for Fake {
    fn get(&self, id: u32) -> io::Result<Option<i32>> {
        Ok(self.values.lock().unwrap().get(&id).copied())
    }

    fn set(&self, id: u32, value: i32) -> io::Result<()> {
        if self.broken.contains(&id) {
            return Err(io::Error::from_raw_os_error(libc::EIO));
        }
        self.values.lock().unwrap().insert(id, value);
        Ok(())
    }
}

const AUTO_EXPOSURE: u32 = LENS + 1;
const AUTO_GAIN: u32 = USER + 18;
const AUTO_FOCUS: u32 = LENS + 12;

#[test]
fn locks_hold_the_present_values_and_are_undone() {
    let camera = Fake::new(&[(AUTO_EXPOSURE, 3), (EXPOSURE_TIME, 156), (AUTO_GAIN, 1), (GAIN, 40)]);
    assert!(any_automatic(&*camera, &[Lockable::Gain]));
    assert!(!any_automatic(&*camera, &[Lockable::Focus]));
    let what = [Lockable::Exposure, Lockable::Gain];
    let (locked, complaints) = Locked::new(camera.clone(), &what, &Memory::default());
    assert_eq!(complaints, Vec::<String>::new());
    assert_eq!((camera.value(AUTO_EXPOSURE), camera.value(AUTO_GAIN)), (1, 0));
    assert_eq!((camera.value(EXPOSURE_TIME), camera.value(GAIN)), (156, 40));
    drop(locked);
    assert_eq!((camera.value(AUTO_EXPOSURE), camera.value(AUTO_GAIN)), (3, 1));
}

#[test]
fn what_a_camera_lacks_is_reported() {
    let camera = Fake::new(&[(AUTO_GAIN, 0), (GAIN, 40)]);
    let (locked, complaints) = Locked::new(camera.clone(), &Lockable::EACH, &Memory::default());
    assert_eq!(
        complaints,
        ["exposure", "white balance", "focus"]
            .map(|name| format!("the camera has no automatic {name} to lock"))
    );
    drop(locked);
    assert_eq!(camera.value(AUTO_GAIN), 0, "what the user had turned off stays off");
}

#[test]
fn a_control_that_cannot_be_set_is_reported() {
    let camera = Arc::new(Fake { values: Mutex::new([(AUTO_FOCUS, 1)].into()), broken: vec![AUTO_FOCUS] });
    let (_locked, complaints) = Locked::new(camera, &[Lockable::Focus], &Memory::default());
    assert!(complaints[0].contains("focus could not be locked"), "{complaints:?}");
}

#[test]
fn a_camera_that_is_back_gets_its_old_values() {
    let memory = Memory::default();
    let before = Fake::new(&[(AUTO_EXPOSURE, 3), (EXPOSURE_TIME, 156)]);
    drop(Locked::new(before, &[Lockable::Exposure], &memory));
    assert!(memory.knows_values());
    // One that kept what it was locked at while it was away.
    let kept = Fake::new(&[(AUTO_EXPOSURE, 1), (EXPOSURE_TIME, 20)]);
    let (locked, _) = Locked::new(kept.clone(), &[Lockable::Exposure], &memory);
    assert_eq!((kept.value(AUTO_EXPOSURE), kept.value(EXPOSURE_TIME)), (1, 156));
    drop(locked);
    assert_eq!(kept.value(AUTO_EXPOSURE), 3, "as it was before the run");
}
