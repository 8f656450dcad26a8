//! Read-back of a finished picture and of the counters of its work.

use std::ops::Range;

use carina_raycast::CastStats;

use crate::{
    Gpu, GpuError,
    device::lock,
    picture::{Picture, WORDS_OF_A_WALL},
    resources::{COUNT_BYTES, RESULT_BYTES},
};

/// Number of counters of a picture's work (rays, samples, look-ups and others) that the device returns.
const COUNTS: usize = 5;

/// Results of a picture that are read back: counters, and numbers of shaded walls and requested bricks.
pub(crate) struct Results<'a> {
    pub(crate) pixels: &'a [u8],
    pub(crate) counts: &'a [u8],
    /// Number of pixels whose first wall was shaded.
    pub(crate) num_lit: u32,
    /// Number of bricks (cubes of voxels) of slopes that pictures of the volume have requested.
    num_requested: u32,
}

impl Gpu {
    /// Read a picture back, pass its results to `take`, and return the slot for later pictures.
    ///
    /// `pixels` are the pixels of the picture's buffers that are read.
    pub(crate) fn results<T>(
        &self,
        picture: Picture<'_>,
        pixels: Range<usize>,
        take: impl FnOnce(&Results<'_>) -> T,
    ) -> Result<T, GpuError> {
        let slot = picture.slot;
        let (from, words) = if picture.variant.walls && picture.light.is_none() {
            (&slot.walls, WORDS_OF_A_WALL)
        } else {
            (&slot.pixels, 1)
        };
        let bytes_of = |pixels: usize| (4 * words * pixels) as u64;
        let pixel_bytes = bytes_of(pixels.len());
        let parts = [
            (from, bytes_of(pixels.start), pixel_bytes),
            (&slot.counts, 0, COUNT_BYTES),
            (&slot.state, 0, RESULT_BYTES),
        ];
        let requested = picture
            .light
            .as_ref()
            .map(|(_, slopes)| (&slopes.bricks, 0, 4));
        let mut encoder = self.encoder();
        let mut end = 0;
        for (buffer, start, bytes) in parts.into_iter().chain(requested) {
            encoder.copy_buffer_to_buffer(buffer, start, &slot.staging, end, bytes);
            end += bytes;
        }
        let index = self.queue.submit([encoder.finish()]);
        // The read-back is queued behind the kernels; another thread may submit its picture while this one waits.
        let (sender, receiver) = std::sync::mpsc::channel();
        slot.staging
            .map_async(wgpu::MapMode::Read, 0..end, move |done| {
                let _ = sender.send(done);
            });
        self.wait(index);
        self.check_alive()?;
        let lost = |reason: String| GpuError::Device {
            name: self.facts.name.clone(),
            reason,
        };
        // The first thread that detects the completion of a read-back runs all callbacks, also that of another thread's
        // picture.
        receiver
            .recv_timeout(self.facts.kind.patience())
            .map_err(|_| lost("the picture did not come back".to_owned()))?
            .map_err(|e| lost(e.to_string()))?;
        let taken = {
            let bytes = slot.staging.get_mapped_range(0..end);
            let bytes = bytes.map_err(|e| lost(e.to_string()))?;
            let (pixels, rest) = bytes.split_at(pixel_bytes as usize);
            let (counts, rest) = rest.split_at(COUNT_BYTES as usize);
            let word = |at: usize| {
                let word = rest.get(at..at + 4);
                word.map_or(0, bytemuck::pod_read_unaligned)
            };
            let results = Results {
                pixels,
                counts,
                num_lit: word(4),
                num_requested: word(RESULT_BYTES as usize),
            };
            if let Some((_, slopes)) = &picture.light {
                slopes.record_requested(results.num_requested);
            }
            take(&results)
        };
        slot.staging.unmap();
        self.check_alive()?;
        // The slot is returned only after success, because the slot of a failed picture may still be mapped or in use.
        lock(&self.slots).push(slot);
        Ok(taken)
    }
}

/// Add the counters that the device returned for a picture to the statistics.
pub(crate) fn add_counts(stats: &mut CastStats, counts: &[u8], shaded: bool) {
    for counts in counts.as_chunks::<{ 8 * COUNTS }>().0 {
        let [samples, lookups, leaps, skipped, lit] =
            bytemuck::pod_read_unaligned::<[u64; COUNTS]>(counts).map(u64::from_le);
        stats.num_samples += samples;
        stats.num_lookups += lookups;
        stats.num_leaps += leaps;
        stats.num_skipped += skipped;
        stats.num_shaded += if shaded { lit } else { 0 };
    }
}
