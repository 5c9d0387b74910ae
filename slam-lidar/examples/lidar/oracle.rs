//! What scans tell by the true normals of what they see.

use geometry::Se3;
use loopbox_tests::lidar::PERIOD;
use loopbox_tests::lidar_open::Drive;
use loopbox_tests::lidar_sensors::Sensed;
use nalgebra::{Matrix6, Vector3, Vector6};
use slam_lidar::degeneracy::{WEAK_TRANSLATION, conditioning};
use slam_lidar::motion::{MotionTable, SweepMotion};
use slam_lidar::odometry::OdometryParams;
use slam_lidar::surfaces::{SurfaceMap, SurfaceParams};
use slam_lidar::voxels::{VoxelTable, first_of_each_voxel};

/// A map without drift, with which scans are compared.
pub struct Oracle {
    map: SurfaceMap,
    params: OdometryParams,
}

impl Oracle {
    /// With the resolution that the odometry takes for a drive that begins with these points.
    pub fn new(first: &[Sensed]) -> Self {
        let points: Vec<[f32; 3]> = first.iter().map(|s| s.point).collect();
        let params = OdometryParams::default();
        let surfaces = SurfaceParams { voxel: params.voxel_for(&points), ..params.surfaces };
        Self { map: SurfaceMap::new(surfaces), params }
    }

    /// The direction along which a scan leaves the translation open, if it does.
    pub fn open(&mut self, sensed: &[Sensed], drive: &Drive, stamp: f64) -> Option<Vector3<f64>> {
        let points: Vec<[f32; 3]> = sensed.iter().map(|s| s.point).collect();
        let motion = SweepMotion { begin: drive.path.at(stamp), end: drive.path.at(stamp + PERIOD) };
        let centre = motion.middle().translation;
        let table = MotionTable::new(&motion, &Se3::identity());
        let world = |i: u32| table.transform(points[i as usize], sensed[i as usize].time / PERIOD as f32);
        let (mut kept, mut scratch) = (vec![], VoxelTable::default());
        first_of_each_voxel(&points, self.params.registered * self.map.voxel(), &mut scratch, &mut kept);
        let mut information = Matrix6::zeros();
        for &i in &kept {
            let point = world(i);
            if self.map.surface_at(point).is_some_and(|s| s.constraints() > 0) {
                let mut normal = Vector3::zeros();
                normal[usize::from(sensed[i as usize].normal)] = 1.0;
                let moment = (Vector3::from(point.map(f64::from)) - centre).cross(&normal);
                let row = Vector6::new(normal.x, normal.y, normal.z, moment.x, moment.y, moment.z);
                information += row * row.transpose() / (0.02f64.powi(2) * 10.0);
            }
        }
        first_of_each_voxel(&points, self.params.mapped * self.map.voxel(), &mut scratch, &mut kept);
        self.map.insert(kept.iter().map(|&i| world(i)));
        let found = conditioning(&information);
        (found.translation > WEAK_TRANSLATION).then(|| Vector3::from(found.weakest))
    }
}
