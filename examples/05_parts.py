"""The parts of the paper used alone, without a hand, a memory or a controller."""

import numpy as np

from preshape.hiis.analyser import Aim, HandLayout
from preshape.hiis.fuzzy import FuzzySets, approaching_degrees, tfvadi
from preshape.hiis.planes import PLANES
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.hiis.wrench import screw_measures
from preshape.objects.load import load_object

q1 = np.array([1.0, 1.0, 0.1, 0.05, 0.8, 0.05])  # table 1
print("fig. 14, row 2:", tfvadi(q1, [1.3, 1.1, -0.27, 0.06, 0.86, 0.11]).round(3))

narrow_zero = FuzzySets().changed({"ZERO": [-0.08, -0.03, 0.03, 0.08]})  # fig. 16
print("with a narrow ZERO:", tfvadi(q1, [1.3, 1.1, -0.27, -0.06, 0.86, 0.11], narrow_zero).round(3))

for plane in PLANES[:3]:
    print(plane.label, "transverse", plane.transverse_axis)

layout = HandLayout(name="two chopsticks", u=0.043, finger_pitch=0.025, fingertip_width=0.010)
analyser = RayAnalyser(load_object("bottle"), layout)
found = analyser.explore(q1, Aim(values=np.linspace(-0.9, 0.9, 19)))
best = found.grasp()
print(f"{len(found)} virtual grasps; the best is {best.plane.label}, TFVADI {best.tfvadi:.2f}")
print("per component:", approaching_degrees(q1, best.net_wrench).round(2))

contacts = best.contacts
r = (contacts.points - analyser.mesh.cog) / layout.u
print("stability and manipulability, one wrench for each finger:", screw_measures(contacts.wrenches))
print(
    "stability and manipulability, full basis:",
    screw_measures(contacts.wrenches, r, contacts.normals_in, reading="basis"),
)
