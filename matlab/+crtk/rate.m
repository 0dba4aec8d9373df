classdef rate < handle
%RATE  Keeps a loop at a rate. What was late is not made up for.
%
%   rate = ral.rate(200);
%   reset(rate);
%   for k = 1:1000, ...; waitfor(rate); end

    properties (SetAccess = private)
        period  % of the loop, in s
    end

    properties (Access = private)
        start
        next
    end

    methods

        function self = rate(frequency)
            self.period = 1.0 / frequency;
            self.reset();
        end

        function reset(self)
        %RESET  Let the first period begin now.
            self.start = tic;
            self.next = self.period;
        end

        function waitfor(self)
        %WAITFOR  Wait for the end of this period.
            left = self.next - toc(self.start);
            if left > 0.0
                pause(left);
                self.next = self.next + self.period;
            else
                self.next = toc(self.start) + self.period;
            end
        end

        function sleep(self)
        %SLEEP  As waitfor: its name in Python.
            self.waitfor();
        end

    end

end
