//! What `scopeservo init` writes.

use scopeservo_drivers::factory::{FACTORIES, Factory};

/// All but the drivers that have a factory.
const SCHEMA: &str = include_str!("scopeservo.schema.json");
/// Where these go.
const PLACE: &str = "\n     \"@factories\": {}";

/// A JSON schema of the file, for editors.
pub fn schema() -> String {
    schema_with(FACTORIES)
}

/// The same with other drivers than ours.
pub(crate) fn schema_with(known: &[Factory]) -> String {
    let of = |schema: &str| schema.trim_end().replace('\n', "\n     ");
    let all = known.iter();
    let all = all.map(|f| format!("\n     \"{}\": {}", f.kind, of(f.schema)));
    SCHEMA.replace(PLACE, &all.collect::<Vec<_>>().join(","))
}

/// For an instrument of the user's.
pub const TEMPLATE: &str = r#"# What this instrument is made of and what it may do. Units are in the names: um, deg, ms.
# `scopeservo doctor` checks it without moving anything.

name = "my microscope"

# Where calibrations and saved targets are kept, from this folder on.
# data_folder = "scopeservo-data"


# "box": each axis has its whole travel. "ellipsoid": the axes share it, as those of a hexapod do.
# workspace = "ellipsoid"

# A driver is a program that speaks for one or more devices: yours, or one of those that come with scopeservo.
[drivers.main]
program = ["python3", "my_driver.py"]
# or one that runs already:
# tcp = "127.0.0.1:7414"
# secret_file = "secret.txt"      # where it asks for one

# What needs no program: gcs2, gcode and sangaboard stages; mjpeg, snapshot, folder and v4l cameras (docs/adding-a-device.md has them).
# [drivers.eye.mjpeg.settings]
# url = "http://192.168.1.20:8080/stream"
# latency_ms = 250                # from the start of an exposure until the picture is here, at the most
# exposure.now_ms = 10

[devices]
stage = "main"
camera = "main"
nosepiece = "main"                # a driver, or "by-hand" (you are asked to turn it), or "none" (one objective)
# light = "main"

# For a nosepiece by hand, or none. A driver's nosepiece brings its own.
# [[objective]]
# id = "10x"
# magnification = 100             # total; orders the objectives
# numerical_aperture = 0.25
# um_per_px = 1.1                 # nominal size of a camera pixel on the specimen, within 30 %
# immersion = "oil"               # or water, glycerol, silicone; air when left out. You are asked before one takes another's place

# Narrower than the stage's own travel. What lies outside is refused, never clipped.
[limits]
# x_um = [-8000, 8000]
# y_um = [-8000, 8000]
# z_um = [-3000, 500]
# rz_deg = [-20, 20]

# While an objective is in the beam, or may be:
# [limits_for.40x]
# z_um = [-3000, 120]

# The longest way of one move. A retreat from the specimen may be longer.
[largest_step]
# x_um = 20000
# z_um = 500

# Where something is in the way: there no objective comes nearer than this.
# [[zone]]
# name = "the left clamp"
# x_um = [-17000, -14000]
# y_um = [-16000, 16000]
# closest_z_um = -1500
# objectives = ["40x"]            # all when left out

# When the nosepiece may turn, for more than one objective. Write down a height, far from the specimen, at which no objective can
# touch anything on its way. Mind the sign: on the side to which z goes away from the specimen.
# [objective_change]
# retract_z_um = -2000
# margin_um = 50                  # how far from the expected focus an objective stops whose focus was never found
# or, when you are sure that nothing can touch:
# anywhere = true

[camera]
# exposure_ms = 10

[light]
# level = 0.4                     # 0 to 1

# A target is saved with a step aside of some pixels, which shows what is fixed to the camera. Where nothing may move:
# [target]
# still = true

# What is asked of an arrival, where that is not as near as the stage and the images allow. On the command line: --within-um, --within-deg.
# [arrival]
# within_um = 1.5
# within_deg = 5                  # also of what the stage cannot turn

# The focus is looked for in one slow motion first, where that is expected to save time and the stage's speed can be chosen. On the command line:
# --sweep. It saves little, and is somewhat less often within a quarter of the depth of field.
# [focus]
# sweep = true

# Reports of the oldest runs go when all of them take more than this, 10^9 bytes; what happened in them never goes.
# [library]
# frames_gb = 20
"#;

/// For the simulated microscope.
pub const TWIN_TEMPLATE: &str = r#"# The simulated microscope: nothing needs to be connected. Units are in the names: um, deg, ms.

name = "simulated microscope"

[drivers.twin.twin]
seed = 1
# specimen = "slide.png"          # procedural tissue without
# um_per_px = 0.5
# made.lattice = { kind = "hexagonal", pitch_um = 12, disorder = 0.05 }   # or blank, sparse, twice instead of tissue
# made.lattice = { kind = "lines", pitch_um = 20, fill = 0.1 }            # a pattern slide for `scopeservo grid`
# camera.dust = [{ specks = 40, radius_px = [2, 20], steepness = [1, 60] }]   # on the camera; also camera.marks, camera.pattern
centre_um = [0, 0]                # what lies under the view's centre at the start
turned_deg = 0
# tilt_mrad = [5, -3]             # the slide does not lie flat: for `scopeservo level`
# stage = "hexapod"               # or "xyz-theta", "xyz", "xy"
# objectives = ["10x", "40x"]     # of 10x, 20x, 40x
# mirrored = true                 # the camera's picture is mirrored
# distortion = { "40x" = 0.002 }  # moves the corner of the picture out by 0.2 %
# immersion = { "40x" = "oil" }   # or water, glycerol, silicone; air when left out. You are asked before one takes another's place
# real_time = true                # motion takes as long as it would

[devices]
stage = "twin"
camera = "twin"
nosepiece = "twin"

# Narrower than the stage's own travel. What lies outside is refused, never clipped.
[limits]
x_um = [-17000, 17000]
y_um = [-16000, 16000]

# The nosepiece turns only from this height on, away from the specimen.
[objective_change]
retract_z_um = -2000
margin_um = 0
"#;
