//! The controller's refusals: what was found, and what to do (`docs/protocols/hses.md`, section 9).

/// Status bytes that come without an added status.
pub(super) const STATUSES: &[(u8, &str, &str)] = &[
    (0x08, UNKNOWN_COMMAND, CHECK_OPTION),
    (0x09, UNKNOWN_ATTRIBUTE, REPORT),
    (0x28, UNKNOWN_INSTANCE, CHECK_NUMBER),
];

/// Added statuses, by number. Host control's interpreter uses the same up to 5480.
#[rustfmt::skip]
pub(super) const CODES: &[(u16, &str, &str)] = &[
    // The command's form.
    (0x1010, "the controller does not know this word", REPORT),
    (0x1011, "the command has the wrong number of values", REPORT),
    (0x1012, "a value of the command is out of range", "check what was asked for"),
    (0x1013, "a value of the command has the wrong length", REPORT),
    (0x1020, "the controller's storage is full", "delete jobs or files that are not needed"),
    // The state of the controller.
    (0x2010, "the robot is moving", "wait until it stands"),
    (0x2020, "held at the pendant", "release the hold there"),
    (0x2030, "held at the panel", "release the hold there"),
    (0x2040, "held by an external signal", "release it"),
    (0x2050, "held by command", "resume the run"),
    (0x2060, "an error or alarm is present", "remove its cause and reset"),
    (0x2070, "servo power is off", "switch it on"),
    (0x2080, "wrong mode", "turn the mode key to PLAY/REMOTE"),
    (0x2090, "the file is in use elsewhere", "close it on the pendant, then try again"),
    (0x2100, "command remote is not set", "turn the key to REMOTE and set CMD REMOTE SEL (#82015)"),
    (0x2110, "the data cannot be reached", "check the security level and the name"),
    (0x2120, "the data cannot be loaded", "check that the file fits this controller"),
    (0x2130, "the job is being edited", "leave it on the pendant, then try again"),
    (0x2150, "a coordinate conversion is running", "wait until it has ended"),
    // Servo, home, calibration.
    (0x3010, "servo power must be on", "switch it on"),
    (0x3040, "the arm must go to its home position first", "bring it there from the pendant"),
    (0x3050, "the arm's position must be confirmed", "do the second home position check on the pendant"),
    (0x3070, "the arm's present position is not known", "confirm it on the pendant; the battery may be empty"),
    (0x3220, "the panel locks mode and cycle", "release the lock on the panel"),
    (0x3230, "the panel locks the start", "release the lock on the panel"),
    (0x3350, "the user frame is not taught", "teach it, or choose another"),
    (0x3360, "the user frame is broken", "teach it again"),
    (0x3370, "the wrong control group", "choose a job of this robot's group"),
    (0x3380, "the data of the base axis are wrong", "check the job's base axis"),
    (0x3390, "relative jobs cannot be converted here", "allow it in the parameters or use a pulse job"),
    (0x3400, "calling the master job is forbidden by parameter", "select the job by its name"),
    (0x3410, "calling the master job is forbidden by the operation lamp", "wait until the running job has ended"),
    (0x3420, "calling the master job is forbidden by the teach lock", "release the teach lock"),
    (0x3430, "the calibration between robots is missing", "calibrate them"),
    (0x3450, "servo power cannot be switched on", "release the emergency stop, close the doors"),
    (0x3460, "the coordinate system cannot be set", "check the frame and the control group"),
    // Jobs.
    (0x4010, "no memory is left for jobs", DELETE_JOBS),
    (0x4012, "no memory is left for positions", DELETE_JOBS),
    (0x4020, "the job must not be edited", "release its edit lock on the pendant"),
    (0x4030, "a job of this name exists", "delete it first, or choose another name"),
    (0x4040, "there is no such job", "check the name, or load the job first"),
    (0x4060, "no job is selected", "select one first"),
    (0x4120, "the job's positions are broken", BRING_JOB),
    (0x4130, "the job's positions are missing", BRING_JOB),
    (0x4140, "a position variable has the wrong type", "write it in the type that the job expects"),
    (0x4150, "a job that is not the master ends with END", "correct the job"),
    (0x4170, "the job's instructions are broken", BRING_JOB),
    (0x4190, "the job's name has a character that is not allowed", "use letters, digits, hyphens and underscores"),
    (0x4200, "a label has a character that is not allowed", CORRECT_JOB),
    (0x4230, "an instruction is not available on this controller", CORRECT_JOB),
    (0x4420, "the job has no step to convert", CORRECT_JOB),
    (0x4430, "the job is converted already", "use it as it is"),
    (0x4480, "the job needs a user frame", "teach the user frame"),
    (0x4490, "a relative job is not allowed here", "use a pulse job"),
    // The text of files.
    (0x5110, "the file has a syntax error", CORRECT_FILE),
    (0x5120, "the file's positions are wrong", CORRECT_FILE),
    (0x5130, "the file has no NOP or no END", CORRECT_FILE),
    (0x5170, "the file has the wrong format", CORRECT_FILE),
    (0x5180, "the file has the wrong number of values", CORRECT_FILE),
    (0x5200, "a value in the file is out of range", CORRECT_FILE),
    (0x5310, "the file has a syntax error outside its instructions", CORRECT_FILE),
    (0x5340, "a pseudo-instruction of the file is wrong", CORRECT_FILE),
    (0x5370, "a record of the condition file is wrong", CORRECT_FILE),
    (0x5390, "a record of the job file is wrong", CORRECT_FILE),
    (0x5430, "the file is of another system", "take the file of this controller"),
    (0x5480, "the file is for another type of welder", "take the file of this controller"),
    // Memory devices.
    (0x6010, "the robot or a station is working", "wait until it stands"),
    (0x6020, "the memory device has no room", "make room on it"),
    (0x6030, "the memory device cannot be read or written", "check that it is in its slot and not write-protected"),
    (0x6040, "an automatic backup ended unexpectedly", "look at the pendant"),
    (0x6050, "the backup is larger than the memory", MAKER),
    (0x6060, "there was no memory device at power-on", "put it in and switch the controller off and on"),
    (0x6070, "the backup's information is wrong", MAKER),
    (0x6080, "an old backup cannot be removed", "remove it by hand"),
    (0x6090, "an old backup cannot be renamed", "rename it by hand"),
    (0x6100, "the drive has another name", "check the drive"),
    (0x6110, "the device is another", "check the device"),
    (0x6120, "a system error of the backup", MAKER),
    (0x6130, "automatic backup is not available", "switch it on at the controller"),
    (0x6140, "not possible during an automatic backup", WAIT),
    // The protocol.
    (0xA000, UNKNOWN_COMMAND, CHECK_OPTION),
    (0xA001, UNKNOWN_INSTANCE, CHECK_NUMBER),
    (0xA002, UNKNOWN_ATTRIBUTE, REPORT),
    (0xA100, "the answer is larger than the link carries", ASK_LESS),
    (0xA101, "the answer is larger than the setting allows", ASK_LESS),
    (0xB001, "the position variable was never set", "teach or write it first"),
    (0xB002, "this must not be used here", "check the variable's area and the security level"),
    (0xB003, "the data have the wrong length", REPORT),
    (0xB004, "a value is out of range", "the pose lies outside the robot's workspace"),
    (0xB005, "the data are not defined", "check the number"),
    (0xB006, "no such application", "check the number"),
    (0xB007, "the type of the data is refused", "check the variable's type"),
    (0xB008, "the control group is refused", "move robot 1 alone; check the controller's groups"),
    (0xB009, "the speed is refused", "check the station's speeds"),
    (0xB00A, "the speed is missing", "check the station's speeds"),
    (0xB00B, "the coordinate system is refused", "check the frame of the move"),
    (0xB00C, "the arm's configuration is refused", "check type and form of the pose"),
    (0xB00D, "the tool number is refused", "check the station's tool"),
    (0xB00E, "the user frame is refused", "teach it, or choose another"),
    (0xC001, SYSTEM, MAKER),
    (0xC002, SYSTEM, MAKER),
    (0xC003, SYSTEM, MAKER),
    (0xC800, SYSTEM, MAKER),
    (0xCFFF, "an error without a name", "look at the pendant"),
    (0xD8F1, BUSY, WAIT),
    (0xD8FA, "the controller is busy with a command that bars others", WAIT),
    // Files.
    (0xE24F, "the backup's parameter is wrong", "check the backup settings"),
    (0xE250, "the backup cannot be made", "turn the key to REMOTE and set CMD REMOTE SEL (#82015)"),
    (0xE289, FILE_SYSTEM, MAKER),
    (0xE28A, FILE_SYSTEM, MAKER),
    (0xE28B, "the controller has waited too long for the next part of the file", "check the network, then begin again"),
    (0xE28C, "the file must not be overwritten", "delete it first, or choose another name"),
    (0xE29C, "the file is missing or empty", CHECK_FILE_NAME),
    (0xE29D, FILE_SYSTEM, MAKER),
    (0xE29E, FILE_SYSTEM, MAKER),
    (0xE29F, FILE_SYSTEM, MAKER),
    (0xE2A0, "the file's path is wrong", CHECK_FILE_NAME),
    (0xE2A7, "the file is not in the list", CHECK_FILE_NAME),
    (0xE2AA, FILE_SYSTEM, MAKER),
    (0xE2AF, "the file cannot be deleted", "check that it is not protected, selected or running"),
    (0xE2B0, FILE_SYSTEM, MAKER),
    (0xE2B1, "a folder cannot be deleted", CHECK_FILE_NAME),
    (0xE2B2, "files need remote mode", "turn the key to REMOTE and set CMD REMOTE SEL (#82015)"),
    (0xE2B3, "there is no such file", CHECK_FILE_NAME),
    (0xE2B4, "the file's path is too long", "choose a shorter name"),
    (0xE444, "another command is running", WAIT),
    // The form of frames.
    (0xE49D, "a frame had no data", REPORT),
    (0xE49E, "a frame was too long", REPORT),
    (0xE49F, "a frame was empty", REPORT),
    (0xE4A1, "a part of the file came out of order", "check the network, then begin again"),
    (0xE4A2, "a frame's ACK mark was wrong", REPORT),
    (0xE4A3, "a frame's division was wrong", "check the ports of the station: 10040 robot, 10041 files"),
    (0xE4A4, "the access level is too low", "raise the security level on the pendant"),
    (0xE4A5, "a frame's header size was wrong", REPORT),
    (0xE4A6, "a frame's identifier was wrong", REPORT),
    (0xE4A7, "a frame's size was not what it said", "check the network's frame size"),
    (0xE4A8, SYSTEM, MAKER),
    (0xE4A9, SYSTEM, MAKER),
    (0xFFF0, SYSTEM, MAKER),
    (0xFFF1, SYSTEM, MAKER),
    (0xFFF2, SYSTEM, MAKER),
    (0xFFF3, SYSTEM, MAKER),
    (0xFFF4, SYSTEM, MAKER),
    (0xFFF5, SYSTEM, MAKER),
    (0xFFF6, "too many requests at once", "end other clients, then try again"),
    (0xFFF7, SYSTEM, MAKER),
    (0xFFF8, SYSTEM, MAKER),
    (0xFFFE, "the controller ended the connection when remote mode began", "connect again"),
];

const UNKNOWN_COMMAND: &str = "the controller does not know this command";
const UNKNOWN_ATTRIBUTE: &str = "the controller does not know this attribute or service";
const UNKNOWN_INSTANCE: &str = "the controller does not have this number";
const SYSTEM: &str = "an error inside the controller";
const FILE_SYSTEM: &str = "an error of the controller's file system";
const BUSY: &str = "the controller is busy";

const REPORT: &str = "report it, with the recording: the program and this controller differ";
const CHECK_OPTION: &str = "check model and options of the controller";
const CHECK_NUMBER: &str = "check the number of the signal, variable or group";
const CHECK_FILE_NAME: &str = "list the files and check the name";
const CORRECT_JOB: &str = "correct the job";
const CORRECT_FILE: &str = "correct the file and send it again";
const BRING_JOB: &str = "load the job again";
const DELETE_JOBS: &str = "delete jobs that are not needed";
const ASK_LESS: &str = "ask for fewer values at once";
const WAIT: &str = "wait, then try again";
const MAKER: &str = "switch it off and on; if it stays, ask the maker";
