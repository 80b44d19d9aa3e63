"""Ask a running ``preshape serve`` for a grasp of a mug: python client.py [ADDRESS [TOKEN]]."""

import json
import sys
import urllib.error
import urllib.request

address, token = [*sys.argv[1:], "http://localhost:8090", ""][:2] if len(sys.argv) < 3 else sys.argv[1:3]
request = urllib.request.Request(
    f"{address}/plan",
    data=json.dumps({"object": "mug", "task": "pour"}).encode(),
    headers={"Content-Type": "application/json", "Authorization": f"Bearer {token}"},
)
try:
    plan = json.load(urllib.request.urlopen(request))
except urllib.error.HTTPError as error:
    sys.exit(json.load(error)["reason"])
print(plan["object"]["name"], plan["status"], plan["reason"])
if plan["status"] == "answer":
    print("palm at", plan["hand"]["grasp"]["palm_pose"], "joints", plan["hand"]["grasp"]["q"])
