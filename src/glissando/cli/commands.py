"""The commands: the module of each, which is imported when it is run, and its line in the help."""

COMMANDS = {
    "estimate": ("estimate", "estimate a recording"),
    "check": ("check", "check whether confidence is true"),
    "robot": ("robot", "write a robot file for a robot of one's own"),
    "learn": ("learn", "learn a robot file from recordings"),
    "predict": ("predict", "foretell a robot from its tendons"),
    "replay": ("replay", "estimate a recording as if live"),
    "live": ("live", "estimate sensors live"),
    "simulate": ("simulate", "simulate a recording"),
    "plan": ("plan", "plan the slide's path"),
    "design": ("design", "compare designs of the slide"),
    "study": ("study", "sweep settings over many seeds"),
    "view": ("view", "show the robot over time"),
    "figure": ("figure", "draw a figure as PNG, PDF or SVG"),
    "report": ("report", "compare runs on one page"),
    "record": ("record", "record an experiment"),
    "calibrate": ("calibrate", "find clocks, frames and zeros"),
    "import": ("importing", "bring in other files"),
    "export": ("exporting", "write a posterior for others"),
    "doctor": ("doctor", "what works here"),
    "reproduce": ("reproduce", "compute and judge the paper's claims"),
}
