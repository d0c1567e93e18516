// SPDX-License-Identifier: GPL-3.0-or-later
// Job type for Flamenco: bakes many .blend files, one task each. Put it into the `scripts` folder beside
// flamenco-manager. Every worker's Blender needs the Cell Radiosity extension.

const JOB_TYPE = {
    label: "Cell Radiosity",
    description: "Bake interreflected light into the meshes of .blend files",
    settings: [
        { key: "blendfiles", type: "string", required: true, visible: "submission",
          description: "Files to bake, as the workers see them: paths with ; between them" },
        { key: "output", type: "string", subtype: "dir_path", required: false, default: "", visible: "submission",
          description: "Folder for the lit files and their reports; empty: beside each file" },
        { key: "error", type: "string", required: false, default: "2%", visible: "submission",
          description: "Relative error to reach" },
        { key: "options", type: "string", required: false, default: "", visible: "submission",
          description: "More options of `radiosity bake`, with spaces between them" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const files = settings.blendfiles.split(";").map(file => file.trim()).filter(file => file);
    if (!files.length) {
        throw new Error("Cell Radiosity: no .blend file is named");
    }
    const targets = files.map(file => lit(file, settings.output));
    targets.forEach((target, k) => {
        if (targets.indexOf(target) !== k) {
            throw new Error(`Cell Radiosity: two files would be written to ${target}.blend`);
        }
    });
    const more = (settings.options || "").split(/\s+/).filter(word => word);
    files.forEach((file, k) => {
        const task = author.Task(`bake ${file}`, "blender");
        task.addCommand(author.Command("blender-render", {
            exe: "{blender}",
            exeArgs: "{blenderArgs}",
            argsBefore: ["-b"],
            blendfile: file,
            args: ["--command", "radiosity", "bake", "-o", `${targets[k]}.blend`, "--report", `${targets[k]}.json`,
                   "--error", settings.error || "2%", "--keep-going", ...more],
        }));
        job.addTask(task);
    });
}

// Where the result of a file goes, without its ending.
function lit(file, folder) {
    const stem = file.replace(/\.blend$/i, "") + "_radiosity";
    return folder ? folder.replace(/[\\/]+$/, "") + "/" + stem.split(/[\\/]/).pop() : stem;
}
