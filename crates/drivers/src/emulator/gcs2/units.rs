//! A controller that somebody tells to count otherwise.

use super::Gcs2Emulator;

impl Gcs2Emulator {
    /// From now on all axes are counted in another unit, of which there are so many in one of before.
    pub fn count_in(&self, unit: &[u8], per_unit: f64) {
        let mut device = self.device();
        device.stand();
        for place in device.goal.iter_mut() {
            *place *= per_unit;
        }
        device.from = device.goal.clone();
        for axis in &mut device.stage.axes {
            axis.unit = unit.to_vec();
            (axis.low, axis.high) = (axis.low * per_unit, axis.high * per_unit);
        }
    }
}
