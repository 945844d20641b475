"""Motions for a backhoe, or any redundant arm, along a path among obstacles.

    import backhoe_planner as bp

    robot = bp.load_robot("models/backhoe.urdf")
    scene = bp.load_scene("scenes/trench.yaml")
    plan = bp.plan(robot, scene)
    print(plan.verdict, plan.certificate.min_clearance)
    plan.save("plan.json")

SI units and radians everywhere; x away from the machine, y left, z up.
"""

# __init__.pyi lists what is public; each name is imported when it is first used
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.1.0"
