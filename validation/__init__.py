"""Measurements and checks of the planner; not part of the installed package.

A verified plan carries a certificate, but the certificate comes from the same collision
library as the planner. This package checks both on random scenes, by distances that share
no code with them. Tests and scripts import it; it imports `backhoe_planner` by its doors,
and no script.

    module             what it offers
    obstacles          random obstacles, as entries of a scene file; everything draws them here
    scenes             a scene from a start, obstacles and a task
    habitats           sensible sizes around each machine; the forms of narrow sites
    free_space         proofs of free motion between configurations, without the planner
    sites              random sites, each named by machine, kind, task and index
    tabletop           the Panda at a table, a shelf and a cage of bars, each with a known solution
    planar_scenes      random scenes for a planar arm
    printed_laws       the laws as printed and the completed law on planar scenes, counted
    law_runs           each law on the same planar scenes: arrives, touches, jumps
    energy_savings     the work that the optimum saves on straight paths of the backhoe
    signed_distances   exact distances of points to shapes, in plain numpy
    surfaces           points on every link's collision shape
    independent_check  the least distances of a whole motion, and refutations of a certificate
    held_loads         the torques that hold machine and payload at rest, by virtual work
    motion_loads       velocities, accelerations, torques and oil of a motion, and the limits that it exceeds
    telescope          an excavator with a telescopic stick, as URDF text
    pose_arms          redundant arms for paths of full poses, as URDF text
    pose_paths         paths of full poses on these arms
    campaigns          one function called for many cases, in several processes; resumes after a kill
    planning_runs      the planner on many sites: rows, tables, comparisons
    dense_layers       whether a path without a plan has one, by dense samples of the configurations on it
    sequences          random sequences planned leg by leg and with the next leg in mind
    goal_runs          motions to a goal compared with the best known and with their bound
    ompl_planners      OMPL's own planners on the same problem, with the same check and time
    ompl_runs          the planner compared with these on many sites
    roboplan_runs      the planner compared with RoboPlan on problems for the Panda
    step_times         one obstacle course on which the steps of the law and the servo are timed
    scans              the cost of a surveyed site compared with the same site without the survey
    surveys            the surroundings of a machine as a scan and as a height map
    servo_drives       a servo driven among obstacles that stand, appear and move
    recoveries         a servo that starts inside an obstacle or outside a limit
    walking_people     the servo among walking people: its steps and its contacts
    raw_urdf           a URDF as written: links, shapes, masses, joints and their placements
    raw_drive          cylinders, pump and engine as described: lengths, levers, flows, pressures
    raw_soil           the force of the soil on the teeth, from the equilibrium of a wedge
    raw_obstacles      the obstacles of a scene as written
    convex_gaps        distances of convex parts, never below the true ones
    dense_sweep        the least distances of a moving machine, by dense samples
    link_pairs         which links must not touch each other
    random_machines    random machines, written as URDF text with their meshes
    random_attacks     random sites and motions around them, many close to contact
    certificate_attack the certificate against all of these
    mujoco_model       machine and site as a MuJoCo model
    mujoco_replay      motions replayed in it, and their contacts
    job_runs           jobs planned with the chosen and with the plain pattern
    job_check          a second opinion on a job: its motions against the ground at their time, its volumes
    study_runs         studies that are killed, sent to a cluster or timed
    placements         an obstacle put on a plan while a servo follows it
    removals           an obstacle put before the end of a plan while a servo follows it, and removed
    moving_balls       plans with something to keep, followed among balls that fly past
    undisturbed        plans followed without new obstacles: their duration compared with the planned one
    startup_times      processor time of whole commands
    benches            every benchmark as a function that returns its figures
    bench_figures      these figures in a file, and compared with those of an earlier run
    tables             rows of figures as an aligned table and as CSV

Lengths in metres, angles in radians, times in seconds; x away from the machine, z up.
"""
