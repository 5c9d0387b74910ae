//! The scene for Foxglove: the same topics and coordinate frames as in a map file, served as they grow.

mod gate;

use super::scene::{Cursor, Placed, SceneUpdate, Step};
use super::{Chunk, Picture, Shared, Status};
use anyhow::{Context as _, Result};
use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{
    CameraCalibration, FrameTransform, FrameTransforms, PackedElementField, PointCloud, Pose, PosesInFrame,
    Quaternion, RawImage, Vector3,
};
use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{Channel, Context, FoxgloveError, WebSocketServer};
use geometry::{Pinhole, Sim3};
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How often the scene is looked at for changes.
const ROUND: Duration = Duration::from_millis(100);
/// Of a keyframe this many points are shown: Foxglove draws all it gets.
const POINTS: usize = 8192;
/// Bytes of a point: x, y, z as floats and intensity.
const STRIDE: u32 = 13;
const WORLD: &str = "world";
const CAMERA: &str = "camera";

/// Begins to serve at a port of this machine's own address; says where.
///
/// # Errors
/// When the port cannot be listened at.
pub fn start(shared: &Arc<Shared>, port: u16) -> Result<String> {
    let context = Context::new();
    let sink = Sink {
        image: context.channel_builder("/camera/image").build(),
        calibration: context.channel_builder("/camera/calibration").build(),
        transforms: context.channel_builder("/tf").build(),
        cloud: context.channel_builder("/keyframes/cloud").build(),
        trajectory: context.channel_builder("/trajectory").build(),
        joined: Arc::default(),
    };
    let serve = |at: Ipv4Addr| {
        let server = WebSocketServer::new()
            .name("loopbox")
            .bind(at.to_string(), 0)
            .context(&context)
            .listener(Arc::new(Joined(Arc::clone(&sink.joined))))
            .start_blocking()?;
        Ok::<_, FoxgloveError>((SocketAddr::from((at, server.port())), server))
    };
    let (inner, server) = serve(gate::hidden_address()?)
        // Some systems have no other address of their own: there its port alone hides it.
        .or_else(|_| serve(Ipv4Addr::LOCALHOST))
        .context("cannot start Foxglove's server")?;
    let at = gate::open(port, inner).with_context(|| {
        format!("cannot serve Foxglove at port {port}\nhint: --foxglove=PORT takes another")
    })?;
    let url = format!("ws://{at}");
    let shared = Arc::clone(shared);
    std::thread::Builder::new()
        .name("foxglove".into())
        .spawn(move || {
            // They serve as long as they are not dropped.
            let _kept = (server, context);
            sink.serve(&shared);
        })
        .context("cannot start the thread that serves Foxglove")?;
    Ok(url)
}

/// Notes that someone began to listen, who must get what was sent before.
struct Joined(Arc<AtomicBool>);

impl ServerListener for Joined {
    fn on_subscribe(&self, _client: Client, _channel: ChannelView) {
        self.0.store(true, Ordering::Release);
    }
}

/// The channels.
struct Sink {
    image: Channel<RawImage>,
    calibration: Channel<CameraCalibration>,
    transforms: Channel<FrameTransforms>,
    cloud: Channel<PointCloud>,
    trajectory: Channel<PosesInFrame>,
    joined: Arc<AtomicBool>,
}

impl Sink {
    fn serve(&self, shared: &Arc<Shared>) {
        let mut cursor = Cursor::default();
        let mut trajectory = Vec::new();
        let mut seat = None;
        while !shared.is_over() {
            if self.joined.swap(false, Ordering::AcqRel) {
                cursor = Cursor::default();
            }
            let wanted = self.image.has_sinks();
            seat = if wanted { seat.or_else(|| Some(shared.join())) } else { None };
            let (update, camera) = {
                let scene = shared.scene();
                let camera = scene.agents.first().map(|agent| agent.camera);
                (scene.update_since(&mut cursor, 1 << 20), camera)
            };
            self.publish(&update, camera.as_ref(), &mut trajectory);
            std::thread::sleep(ROUND);
        }
    }

    fn publish(&self, update: &SceneUpdate, camera: Option<&Pinhole>, trajectory: &mut Vec<Step>) {
        if let Some((from, steps)) = &update.trajectory {
            trajectory.truncate(*from);
            trajectory.extend(steps);
            let pose = |step: &Step| {
                let ([x, y, z], [qx, qy, qz, qw]) =
                    (step.position.map(f64::from), step.rotation.map(f64::from));
                Pose {
                    position: Some(Vector3 { x, y, z }),
                    orientation: Some(Quaternion { x: qx, y: qy, z: qz, w: qw }),
                }
            };
            let poses = trajectory.iter().map(pose).collect();
            self.trajectory.log(&PosesInFrame { timestamp: None, frame_id: WORLD.into(), poses });
        }
        let mut transforms: Vec<FrameTransform> = update.keyframes.iter().map(keyframe_transform).collect();
        transforms.extend(update.status.as_deref().and_then(camera_transform));
        if !transforms.is_empty() {
            self.transforms.log(&FrameTransforms { transforms });
        }
        if let Some(picture) = &update.picture {
            self.image.log(&image(picture));
            if let Some(camera) = camera {
                self.calibration.log(&calibration(camera, picture));
            }
        }
        for (placed, chunk) in &update.chunks {
            self.cloud.log(&cloud(placed, chunk));
        }
    }
}

fn keyframe_frame(id: u32) -> String {
    format!("keyframe_{id}")
}

fn keyframe_transform(placed: &Placed) -> FrameTransform {
    let [x, y, z, qx, qy, qz, qw] = placed.world_from_keyframe.rigid().to_tum();
    FrameTransform {
        timestamp: None,
        parent_frame_id: WORLD.into(),
        child_frame_id: keyframe_frame(placed.id),
        translation: Some(Vector3 { x, y, z }),
        rotation: Some(Quaternion { x: qx, y: qy, z: qz, w: qw }),
    }
}

fn camera_transform(status: &Status) -> Option<FrameTransform> {
    let numbers = status.camera?.map(f64::from);
    let rotation = nalgebra::Matrix3::from_column_slice(&numbers[..9]);
    let q = nalgebra::UnitQuaternion::from_matrix(&rotation);
    Some(FrameTransform {
        timestamp: None,
        parent_frame_id: WORLD.into(),
        child_frame_id: CAMERA.into(),
        translation: Some(Vector3 { x: numbers[9], y: numbers[10], z: numbers[11] }),
        rotation: Some(Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
    })
}

fn image(picture: &Picture) -> RawImage {
    RawImage {
        timestamp: None,
        frame_id: CAMERA.into(),
        width: picture.width as u32,
        height: picture.height as u32,
        encoding: "mono8".into(),
        step: picture.width as u32,
        data: picture.grey.clone().into(),
    }
}

/// The camera of a live image, which may be smaller than those it takes.
fn calibration(camera: &Pinhole, picture: &Picture) -> CameraCalibration {
    let shrink = picture.width as f64 / camera.width.max(1) as f64;
    let [fx, fy] = [camera.fx, camera.fy].map(|v| v * shrink);
    // Pixel centres are at integers.
    let [cx, cy] = [camera.cx, camera.cy].map(|v| (v + 0.5) * shrink - 0.5);
    CameraCalibration {
        frame_id: CAMERA.into(),
        width: picture.width as u32,
        height: picture.height as u32,
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..CameraCalibration::default()
    }
}

/// A keyframe's points in its coordinate frame, in map units: Foxglove's frames have no scale.
fn cloud(placed: &Placed, chunk: &Chunk) -> PointCloud {
    let scale = placed.world_from_keyframe.scale;
    let mut data = Vec::with_capacity(POINTS.min(chunk.len()) * STRIDE as usize);
    for ((position, _), intensity) in chunk.positions().zip(chunk.intensities()).take(POINTS) {
        position.iter().for_each(|v| data.extend(((v * scale) as f32).to_le_bytes()));
        data.push(intensity);
    }
    let field =
        |name: &str, offset, kind| PackedElementField { name: name.into(), offset, r#type: kind as i32 };
    let [x, y, z, qx, qy, qz, qw] = Sim3::identity().rigid().to_tum();
    PointCloud {
        timestamp: None,
        frame_id: keyframe_frame(placed.id),
        pose: Some(Pose {
            position: Some(Vector3 { x, y, z }),
            orientation: Some(Quaternion { x: qx, y: qy, z: qz, w: qw }),
        }),
        point_stride: STRIDE,
        fields: vec![
            field("x", 0, NumericType::Float32),
            field("y", 4, NumericType::Float32),
            field("z", 8, NumericType::Float32),
            field("intensity", 12, NumericType::Uint8),
        ],
        data: data.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::chunk::tests::CAMERA;
    use super::super::scene::tests::{chunk, placed};
    use super::*;
    use geometry::GrayImage;

    #[test]
    fn a_live_images_camera_is_as_large_as_it() {
        let mut picture =
            Picture::new(0, 0.0, &GrayImage::from_vec(100, 80, vec![0; 8000]).expect("it fits"));
        assert_eq!(calibration(&CAMERA, &picture).k[..3], [90.0, 0.0, 49.5]);
        (picture.width, picture.height) = (50, 40);
        let halved = calibration(&CAMERA, &picture);
        assert_eq!((halved.width, halved.k[0], halved.k[2], halved.k[5]), (50, 45.0, 24.5, 19.5));
    }

    #[test]
    fn a_cloud_is_in_its_keyframes_frame_and_map_units() {
        let (mut placed, chunk) = (placed(3, 1.0), chunk());
        placed.world_from_keyframe.scale = 2.0;
        let cloud = cloud(&placed, &chunk);
        assert_eq!(cloud.frame_id, "keyframe_3");
        assert_eq!(cloud.data.len(), chunk.len().min(POINTS) * STRIDE as usize);
        let z = f32::from_le_bytes(cloud.data[8..12].try_into().expect("four bytes"));
        let (first, _) = chunk.positions().next().expect("there are points");
        assert!((f64::from(z) - 2.0 * first.z).abs() < 1e-3);
    }
}
