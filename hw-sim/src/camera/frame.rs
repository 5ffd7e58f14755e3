//! What the camera delivers, and what only the simulator knows of it.

/// The mask's bits: no coordinates.
pub const MASK_INVALID: u8 = 1;
/// The mask's bits: brighter than full scale in every pass.
pub const MASK_SATURATED: u8 = 2;
/// The mask's bits: score below the threshold, or lost at a grazing angle.
pub const MASK_LOW_MODULATION: u8 = 4;
/// The mask's bits: hidden from camera 2 or from the projector.
pub const MASK_OCCLUDED: u8 = 8;
/// The mask's bits: removed as a drop-out or at an edge, or beyond the measured range.
pub const MASK_FILTERED: u8 = 16;

/// An organised frame: row-major grids of equal size.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Measured points in the camera frame, mm; NaN in all three where invalid.
    pub xyz_mm: Vec<[f32; 3]>,
    /// Why a pixel is invalid: `MASK_*` bits; 0 where valid.
    pub mask: Vec<u8>,
    /// Brightness of the main pass, 255 is full scale.
    pub intensity: Vec<u8>,
    /// Matching score, 255 is 1; 0 where the projector or a camera does not see the surface.
    pub confidence: Vec<u8>,
    /// Pixels with coordinates.
    pub valid_count: u32,
    /// Pixels brighter than full scale.
    pub saturated_count: u32,
    /// Up to [`SURFACE_POINT_COUNT`] true points of valid pixels in the camera frame, mm, evenly spread by index.
    pub surface_points_mm: Vec<[f64; 3]>,
}

/// What is behind one pixel of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelTruth {
    /// Where the ray meets the surface, with the systematic errors but without any chance, in the camera frame, mm; NaN where it meets none.
    pub point_mm: [f64; 3],
    /// Standard deviation of the noise along the ray, mm; 0 where there is none.
    pub sigma_mm: f64,
    /// Greatest angle between the normal and the rays to the cameras that must see the pixel, rad.
    pub incidence_rad: f64,
    /// Whether all that must see the surface there do, within the measured range.
    pub is_seen: bool,
    /// What touched the pixel: `TOUCHED_*` bits, set whether or not it stayed valid.
    pub touched: u8,
}

impl PixelTruth {
    /// A ray that meets nothing.
    pub const NOTHING: PixelTruth = PixelTruth {
        point_mm: [f64::NAN; 3],
        sigma_mm: 0.0,
        incidence_rad: f64::NAN,
        is_seen: false,
        touched: 0,
    };
}

/// What touched a pixel: the ripple beside a step of brightness.
pub const TOUCHED_RIPPLE: u8 = 1;
/// What touched a pixel: a silhouette mixed it with what is behind, or took it.
pub const TOUCHED_SILHOUETTE: u8 = 2;
/// What touched a pixel: it belongs to a ghost of an inter-reflection.
pub const TOUCHED_GHOST: u8 = 4;
/// What touched a pixel: a gross mismatch.
pub const TOUCHED_OUTLIER: u8 = 8;
/// What touched a pixel: light of a second bounce lowered its score.
pub const TOUCHED_SECOND_BOUNCE: u8 = 16;

/// Most true surface points a frame carries.
pub const SURFACE_POINT_COUNT: usize = 200;
