"""Small machines whose dynamics are known in closed form."""

from __future__ import annotations

MASS, LENGTH = 300.0, 2.0  # of the pendulum [kg], [m]
PENDULUM = f"""<robot name="pendulum">
  <link name="post"/>
  <link name="arm"><collision><geometry><sphere radius="0.01"/></geometry></collision>
    <inertial><origin xyz="{LENGTH} 0 0"/><mass value="{MASS}"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><origin xyz="0 0 2"/><parent link="post"/><child link="arm"/>
    <axis xyz="0 -1 0"/><limit lower="-0.8" upper="0.9" velocity="1" effort="1e4"/></joint>
  <link name="end"/>
  <joint name="tool" type="fixed"><origin xyz="{LENGTH} 0 0"/><parent link="arm"/><child link="end"/></joint>
</robot>"""

# a hinge at the origin and a slide along the arm, from 0 to 0.5 m; the tip is a ball of radius 0.1 m at its end
TURNING_SLIDE = """<robot name="turning slide"><link name="base"/>
  <link name="post"><collision><origin xyz="0 0 -1"/><geometry><sphere radius="0.02"/></geometry></collision></link>
  <link name="ball"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <link name="tip"/>
  <joint name="turn" type="revolute"><parent link="base"/><child link="post"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="post"/><child link="ball"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.5" effort="1" velocity="1"/></joint>
  <joint name="end" type="fixed"><parent link="ball"/><child link="tip"/></joint></robot>"""
