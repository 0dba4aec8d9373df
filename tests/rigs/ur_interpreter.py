"""A simulated UR controller in virtual time, with a client of its interpreter port, for tests."""

from crtk_sim_backends.ur.messages import RuntimeExceptionMessage, TextMessage
from crtk_sim_backends.ur.ports.interpreter_port import InterpreterSession
from crtk_sim_backends.ur.safety.modes import RuntimeState
from rigs.ur_controller import Bench

WAIT = "interpreter_mode(clearQueueOnEnter=False)"


class Interpreted(Bench):
    """A controller and a client of its interpreter port."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.session = InterpreterSession(self.controller.interpreter)

    @classmethod
    def with_program(cls):
        """With a program in interpreter mode."""
        bench = cls()
        bench.start('a = 1\ninterpreter_mode()\ntextmsg("after ", a)')
        bench.ticks(2)
        return bench

    def send(self, *lines):
        """Answers that are there at once."""
        return self.answers("".join(f"{line}\n" for line in lines).encode())

    def answers(self, data=b""):
        return self.session.receive(data).decode().split("\n")[:-1]

    def ask(self, line):
        """The answer, however long it takes."""
        found = self.send(line)
        for _ in range(5000):
            if found:
                break
            self.ticks(1)
            found = self.answers()
        (answer,) = found
        return answer

    def state(self, name):
        number, question = self.ask(name).removeprefix("state: ").split(": ")
        assert question == name
        return int(number)

    @property
    def texts(self):
        return [message.text for message in self.of_type(TextMessage)]

    @property
    def errors(self):
        self.messages += self.controller.take_messages()
        return [message.text for message in self.of_type(RuntimeExceptionMessage)]

    @property
    def stopped(self):
        return self.controller.runtime_state == RuntimeState.STOPPED
