"""Malformed input for every port of a UR controller: what once was, or could be, misunderstood.

`CORPUS` maps a port to named byte strings. Add what a search finds.
"""

from __future__ import annotations

import struct


def rtde(kind: str, payload: bytes = b"", size: int | None = None) -> bytes:
    """Build one RTDE package; `size` in place of the true one."""
    return struct.pack(">HB", 3 + len(payload) if size is None else size, ord(kind)) + payload


V2 = rtde("V", b"\0\2")
NAN = struct.pack(">d", float("nan"))
INFINITY = struct.pack(">d", float("inf"))
TICK = struct.pack(">d", 500.0)

RTDE = {
    "nothing": b"",
    "size of zero": b"\0\0\x56",
    "size of its own header": rtde("V"),
    "size without body": rtde("O", b"", 65535),
    "largest package": rtde("M", b"x" * 65532),
    "packages without a body": b"".join(map(rtde, "VvOISPUM")),
    "packages of every type": b"".join(rtde(chr(kind), b"\0\0") for kind in range(256)),
    "versions that are none": b"".join(rtde("V", bytes([a, b])) for a in (0, 255) for b in (0, 3)),
    "start without a recipe": V2 + rtde("S") + rtde("S") + rtde("P"),
    "rate that is no number": V2 + rtde("O", NAN + b"timestamp") + rtde("S"),
    "infinite rate": V2 + rtde("O", INFINITY + b"timestamp") + rtde("S"),
    "negative rate": V2 + rtde("O", struct.pack(">d", -500.0) + b"timestamp") + rtde("S"),
    "rate of seven bytes": V2 + rtde("O", TICK[:7]),
    "names that are none": V2 + rtde("O", TICK + b",,, ,\0,\xff\xfe,'],__import__('os'),"),
    "names with code": V2 + rtde("O", TICK + b"timestamp'] + image['actual_q") + rtde("S"),
    "a name of 60 kB": V2 + rtde("O", TICK + b"a" * 60000),
    "the same name often": V2 + rtde("O", TICK + b"timestamp," * 6000) + rtde("S"),
    "a recipe that fits no package": V2 + rtde("O", TICK + b"actual_q," * 6000) + rtde("S"),
    "names whose answer fits no package": V2 + rtde("I", b"a," * 30000),
    "properties that are none": V2 + rtde("R", b",\0,\xff,") + rtde("R") + rtde("R", b"," * 30000),
    "more input recipes than numbers": V2 + rtde("I", b"input_int_register_40") * 300,
    "input for no recipe": V2 + rtde("U", b"\0") + rtde("U", b"\xff" + bytes(100)),
    "input that is too short": V2 + rtde("I", b"external_force_torque") + rtde("U", b"\1" + NAN),
    "force that is no number": V2
    + rtde("I", b"external_force_torque")
    + rtde("U", b"\1" + (NAN + INFINITY) * 3),
    "slider that is no number": V2
    + rtde("I", b"speed_slider_mask,speed_slider_fraction")
    + rtde("U", b"\1" + b"\xff" * 4 + NAN)
    + rtde("U", b"\1" + b"\xff" * 4 + struct.pack(">d", 1.0)),
    "analog output that is no number": V2
    + rtde("I", b"standard_analog_output_mask,standard_analog_output_0,standard_analog_output_1")
    + rtde("U", b"\1\xff" + NAN + INFINITY)
    + rtde("U", b"\1\xff" + bytes(16)),
    "text without its parts": V2 + rtde("M", b"\xff") + rtde("M", b"\xffab\xff"),
    "another protocol": b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n",
}

TEXT = {
    "empty lines": b"\n\r\n\n\0\n" * 50,
    "no end of line": b"x" * 10_000,
    "a line of a megabyte": b"y" * (1 << 20) + b"\n",
    "bytes that are no text": bytes(range(256)) * 20 + b"\n",
    "format characters": b"%s%n{0}{}{robot.controller}\n",
    "another protocol": b"\x16\x03\x01\x02\0\1\0\1\xfc\3\3" + bytes(500),
}

DASHBOARD = TEXT | {
    "commands without arguments": b"load\nload installation\nset operational mode\npopup\naddToLog\n",
    "paths out of the folder": b"load ../../etc/passwd\nload /etc/passwd\nload \0\nload .\nload /\n",
    "a path of 4000 bytes": b"load " + b"a/" * 2000 + b"\n",
    "arguments that are no text": b"load \xff\xfe.urp\npopup \xff\xfe\naddToLog \xed\xa0\x80\n",
    "roles and modes that are none": b"setUserRole king\nset operational mode NONE\n",
}

SCRIPT = TEXT | {
    "program without its end": b"def p():\n  while True:\n",
    "ends alone": b"end\n" * 200,
    "blocks in blocks": b"def p():\n" + b"if True:\n" * 300 + b"end\n" * 301,
    "brackets in brackets": b"textmsg(" * 500 + b")" * 500 + b"\n",
    "operators alone": b"def p():\n  = + * / ( ] } \xc2\xa7\nend\n",
    "string without its end": b'def p():\n  textmsg("abc\nend\n',
    "numbers beyond numbers": b"def p():\n  x = 1e999999 - 1e999999\n  textmsg(to_str(x))\nend\n",
    "names of the host language": b"def p():\n  __import__('os')\n  print(open)\nend\n",
    "program inside a program": b"def p():\ndef q():\nsec r():\nend\nend\nend\n",
    "recursion": b"def p():\n  def f(x):\n    return f(x)\n  end\n  f(1)\nend\n",
    "loop without a pause": b"sec p():\n  while True:\n    x = 1\n  end\nend\n",
    "motion to nowhere": b"movej([1e99,0,0,0,0,0])\nmovel(p[9,9,9,9,9,9])\nspeedj([0,0],0)\n",
    "many programs": b"def p():\n  sync()\nend\n" * 200,
}

INTERPRETER = TEXT | {
    "every command": b"abort\nskipbuffer\nstatelastexecuted\nstatelastinterpreted\nstatelastcleared\n"
    b"stateunexecuted\n" * 20,
    "commands that are none": b"abort abort\nABORT\nabort()\nstate: 1: statelastexecuted\nskipbuffer 1\n",
    "blocks without their end": b"def p():\nif True:\nwhile True:\nthread t():\nend end\n",
    "blocks in blocks": b"if True: " * 300 + b"end " * 300 + b"\n",
    "loops in loops": b"while False: " * 25 + b"end " * 25 + b"\n",
    "brackets in brackets": b"textmsg(" * 500 + b")" * 500 + b"\n",
    "words that stand nowhere": b"return\nbreak\ncontinue\nend\nelse\nreturn 1\nlocal\nglobal\n",
    "string without its end": b'textmsg("abc\ntextmsg(1)\n',
    "names of the host language": b"f0()\nouter()\nstatements()\nbudget = 5\nv0_a = 1\nb_sync()\n"
    b"x = __import__('os')\nrun sync()\nx = None\nyield = 1\nlambda = 2\n",
    "arguments that only the compiler gives": b"interpreter_mode(enclosing=1)\n",
    "definitions over definitions": b"def f(): return 1 end def f(): return f() end\n" * 100,
    "a variable for each line": b"".join(b"x%d = [1, 2, 3]\n" % i for i in range(300)),
    "one line of 60 kB": b"x = 1 " * 10_000 + b"\n",
    "clear and end in one line": b"clear_interpreter() end_interpreter() clear_interpreter() x = 1\n"
    * 20,
    "clear in a function": b"def f(): clear_interpreter() end\nf() f()\n",
    "threads that start threads": b"thread t(): run t() sync() end\nrun t()\n",
    "a thread that clears": b"thread t(): clear_interpreter() end\nrun t()\n",
    "loop without a pause": b"while True: x = 1 end\n",
    "recursion": b"def f(x): return f(x) end f(1)\n",
    "a function without its definition": b"def g(): return 1 end\nskipbuffer\ng()\n",
    "motion to nowhere": b"movej([1e99,0,0,0,0,0]) movel(p[9,9,9,9,9,9]) speedj([0,0],0)\n",
    "numbers beyond numbers": b"x = 1e999999\nx = 1e308 * 10 textmsg(to_str(x))\n",
}

API = b"/universal-robots/robot-api"


def upload(kind: bytes, body: bytes) -> bytes:
    """A program that is sent to the Robot API, or what is to look like one."""
    head = b"POST " + API + b"/programs/v1/ HTTP/1.1\r\nContent-Type: " + kind
    return head + b"\r\nContent-Length: %d\r\n\r\n" % len(body) + body


PART = b'--x\r\nContent-Disposition: form-data; name="file"\r\n\r\n'
ROBOT_API = {
    "a form without parts": upload(b"multipart/form-data; boundary=x", b"--x--"),
    "a form without a boundary": upload(b"multipart/form-data", PART + b"{}\r\n--x--"),
    "a form of bytes": upload(b"multipart/form-data; boundary=x\xff", PART + b"\xff\xfe\0" * 99),
    "a form in forms": upload(
        b"multipart/mixed; boundary=x",
        b"--x\r\nContent-Type: multipart/mixed; boundary=x\r\n\r\n" * 99,
    ),
    "JSON in JSON in a form": upload(
        b"multipart/form-data; boundary=x", PART + b"[" * 90000 + b"\r\n--x--"
    ),
    "a form in a code that is none": upload(
        b"multipart/form-data; boundary=x; charset=nothing",
        PART.replace(b"\r\n\r\n", b"\r\nContent-Transfer-Encoding: base64\r\n\r\n") + b"?\r\n--x--",
    ),
    "no HTTP": b"\r\n\r\n" + TEXT["bytes that are no text"],
    "a head without its end": b"GET " + API + b" HTTP/1.1\r\n" + b"A: b\r\n" * 5000,
    "a body that is no JSON": b"PUT "
    + API
    + b"/program/v1/loaded HTTP/1.1\r\nContent-Length: 5\r\n\r\n{{{{\xff",
    "JSON in JSON": b"PUT "
    + API
    + b"/program/v1/loaded HTTP/1.1\r\nContent-Length: 90000\r\n\r\n"
    + b"[" * 90000,
    "a length that is none": b"POST " + API + b"/popup/v1 HTTP/1.1\r\nContent-Length: \xb2\r\n\r\n",
    "headers without colons": b"GET " + API + b"/openapi.json HTTP/1.1\r\n:\r\nx\r\n\r\n",
    "paths out of the folder": b"PUT "
    + API
    + b"/program/v1/loaded HTTP/1.1\r\nContent-Length: 26\r\n\r\n"
    + b'{"name": "../../etc/hosts"}'[:26],
}

CORPUS: dict[str, dict[str, bytes]] = {
    "rtde": RTDE,
    "dashboard": DASHBOARD,
    "interpreter": INTERPRETER,
    **dict.fromkeys(("primary", "secondary", "realtime"), SCRIPT),
    **dict.fromkeys(("primary_read_only", "secondary_read_only", "realtime_read_only"), SCRIPT),
}
